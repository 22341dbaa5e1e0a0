"""Measured numbers in the documentation stand in the tables of our runs that lie beside it."""

import csv
import re
from collections import defaultdict
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
MEASURED = {
    "reproduction.md": "## The paper says, we find",
    "findings.md": "## What we found",
    "transport.md": "## Measured",
}
"""Documents, and the heading of the part in which every number is a measurement."""

COLUMNS = (
    "printed", "published_program", "ours", "standard_deviation", "minus_printed", "minus_program",
)  # fmt: skip
COUNT = re.compile(r"\b\d+ of \d+\b")
NUMBER = re.compile(r"(?<![\w.,/-])\d*\.\d{3,4}(?![\w.])")


def rows():
    """The numbers of each row of the committed tables."""
    found = defaultdict(list)
    for path in DOCS.glob("results/tables/*.csv"):
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                found[path.stem, row.get("row")] += [
                    abs(float(row[name])) for name in COLUMNS if row.get(name)
                ]
    return list(found.values())


def sentences():
    """The numbers of the reports outside their tables: what was found over many rows."""
    lines = [
        line
        for path in DOCS.glob("results/*.md")
        for line in path.read_text(encoding="utf-8").splitlines()
    ]
    return numbers("\n".join(line for line in lines if line[:1] != "|"))


def part(name):
    """The measurements of a document: from their heading to the next one of its level."""
    text = (DOCS / name).read_text(encoding="utf-8").split(MEASURED[name])[1]
    return re.split(r"^## ", text, flags=re.MULTILINE)[0]


def numbers(text):
    """Those with three digits or four behind the point, as they stand there."""
    return NUMBER.findall(text)


def is_among(number, values):
    """Whether a number is one of these, to the digits that are shown."""
    half_a_digit = 0.501 * 10.0 ** -len(number.split(".")[1])
    return any(abs(float(value) - float(number)) <= half_a_digit for value in values)


@pytest.mark.parametrize("name", MEASURED)
def test_every_measurement_is_in_a_table(name):
    """What stands together, in a row or in a cell of one, is of one row of our tables.

    A number that stands alone is told by a sentence of the report, or in a table.
    """
    known, told = rows(), sentences()
    every = [value for values in known for value in values] + told
    measured = part(name)
    assert len(numbers(measured)) > 10

    def is_of_one_row(shown):
        return any(all(is_among(number, values) for number in shown) for values in known)

    for line in measured.splitlines():
        if line[:1] != "|":
            for number in numbers(line):
                assert is_among(number, every), (number, line)
        elif not is_of_one_row(numbers(line)):
            for cell in line.split("|"):
                shown = numbers(cell)
                is_told = all(is_among(number, told) for number in shown)
                assert is_told or (len(shown) > 1 and is_of_one_row(shown)), (cell, line)


def test_every_count_of_the_claims_is_told_by_a_report():
    """What holds on so many of so many is counted by the program, not by hand."""
    told = set(COUNT.findall("\n".join(p.read_text("utf-8") for p in DOCS.glob("results/*.md"))))
    counts = COUNT.findall(re.sub(r'"[^"]*"', "", part("reproduction.md")))
    assert len(counts) > 10
    assert set(counts) <= told


def test_every_claim_has_its_place_and_a_verdict():
    """At least 25 sentences of the paper, each with one of five verdicts."""
    claims = [line.split(" | ") for line in part("reproduction.md").splitlines()[4:] if line]
    claims = [claim for claim in claims if claim[0].startswith("|")]
    assert len(claims) >= 25
    for number, claim in enumerate(claims, 1):
        assert claim[0] == f"| {number}"
        assert len(claim) == 7 and claim[1] and claim[2]
        assert claim[3] in ("holds", "holds weakly", "fails", "not testable", "open there")
