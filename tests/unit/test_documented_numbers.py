"""Measured numbers in the documentation stand in the tables of our runs that lie beside it."""

import csv
import re
from collections import defaultdict
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
MEASURED = {"reproduction.md": "## What we found", "transport.md": "## Measured"}
"""Documents, and the heading below which every number is a measurement."""

COLUMNS = (
    "printed", "published_program", "ours", "standard_deviation", "minus_printed", "minus_program",
)  # fmt: skip
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
    measured = (DOCS / name).read_text(encoding="utf-8").split(MEASURED[name])[1]
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
                assert (
                    is_of_one_row(shown)
                    if len(shown) > 1
                    else all(is_among(number, told) for number in shown)
                ), (cell, line)
