"""Measured numbers in the documentation stand in the tables of our runs that lie beside it."""

import csv
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
MEASURED = {"reproduction.md": "## What we found", "method.md": "## Measured"}
"""Documents, and the heading below which every number is a measurement."""

COLUMNS = (
    "printed", "published_program", "ours", "standard_deviation", "minus_printed", "minus_program",
)  # fmt: skip
NUMBER = re.compile(r"(?<![\w.,/-])\d*\.\d{3,4}(?![\w.])")


def tabulated():
    """Every number of the committed tables, and of the sentences of the reports."""
    numbers = set()
    for path in DOCS.glob("results/tables/*.csv"):
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                numbers |= {abs(float(row[name])) for name in COLUMNS if row.get(name)}
    for path in DOCS.glob("results/report.md"):
        numbers |= {float(text) for text in NUMBER.findall(path.read_text(encoding="utf-8"))}
    return numbers


@pytest.mark.parametrize("name", MEASURED)
def test_every_measurement_is_in_a_table(name):
    """To the digits that are shown."""
    known = tabulated()
    text = (DOCS / name).read_text(encoding="utf-8").split(MEASURED[name])[1]
    shown = NUMBER.findall(text)
    assert len(shown) > 10
    for number in shown:
        half_a_digit = 0.501 * 10.0 ** -len(number.split(".")[1])
        assert any(abs(value - float(number)) <= half_a_digit for value in known), number
