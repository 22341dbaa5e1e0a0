"""CSV for spreadsheets, which take a cell for a formula that begins like one."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

FORMULA_BEGINS = ("=", "+", "-", "@", "\t", "\r")


def csv_table(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table with its column names; texts that begin like a formula get an apostrophe before."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow([_plain(name) for name in names])
    writer.writerows([_plain(cell) for cell in row] for row in rows)
    return text.getvalue()


def _plain(cell: Any) -> Any:
    if isinstance(cell, str) and cell.startswith(FORMULA_BEGINS):
        return f"'{cell}"
    return cell
