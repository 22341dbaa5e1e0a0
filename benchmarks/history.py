"""What was measured until now, and what has become worse: `python -m benchmarks.history [--table]`.

The commands `benchmarks`, `benchmarks.service`, `benchmarks.animated_glb` and `benchmarks.web_page`
add what they measure, with `--record`, to `results/history.jsonl`, one document a line. Here each
row's last number stands beside the median of those before it on the same machine; the exit status
is the number of rows that are worse by a quarter or more. `--table` prints the table of
docs/performance.md instead.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.comparison import Row, number
from benchmarks.record import fields
from benchmarks.service.measurement import Measurement

FILE: Path = Path(__file__).parent / "results" / "history.jsonl"

WORSE = 1.25
"""A number so many times as bad as before is told; timings of a shared machine differ by less."""

REMEMBERED = 5
"""Earlier records that a number is compared with."""


@dataclass(frozen=True)
class Entry:
    """A row of a record.

    Attributes:
        what: What was measured.
        value: The number that the bar is about.
        unit: Its unit; `x` for how many times better than a peer.
        bar: What it should reach, if anything.
        larger_is_better: Its direction.
        date: Of the record.
        commit: That was measured.
        machine: Processor and number of cores.
    """

    what: str
    value: float
    unit: str
    bar: float | None
    larger_is_better: bool
    date: str
    commit: str
    machine: str


def record(rows: Sequence[Row | Measurement], file: Path = FILE, **conditions: str) -> None:
    """Add what was measured to the file."""
    document = fields([_stored(row) for row in rows if _is_number(row)], **conditions)
    with file.open("a", encoding="utf-8") as history:
        history.write(json.dumps(document) + "\n")


def entries(lines: Iterable[str]) -> dict[str, list[Entry]]:
    """All entries by what they measure, the oldest first."""
    found: dict[str, list[Entry]] = {}
    for line in lines:
        document = json.loads(line)
        machine = document["machine"].partition(", load")[0]
        database = [document["database"]] if "database" in document else []
        about = {
            "date": document["date"],
            "commit": document["commit"][:8],
            "machine": ", ".join([machine, *database]),
        }
        for row in document["rows"]:
            found.setdefault(row["what"], []).append(Entry(**row, **about))
    return found


def change(history: Sequence[Entry]) -> float | None:
    """How many times as bad the last entry is as those before it; None where there are none."""
    last = history[-1]
    before = [entry.value for entry in history[:-1] if entry.machine == last.machine]
    if not before:
        return None
    usual = median(before[-REMEMBERED:])
    better, worse = (last.value, usual) if last.larger_is_better else (usual, last.value)
    if better == 0:
        return 1.0 if worse == 0 else float("inf")
    return worse / better


def table(found: dict[str, list[Entry]]) -> str:
    """The last entry of each row, in Markdown."""
    lines = ["| row | measured | bar | day, commit |", "|---|---|---|---|"]
    for what, history in found.items():
        last = history[-1]
        sign = "≥" if last.larger_is_better else "≤"
        bar = f"{sign} {number(last.bar)}" if last.bar is not None else "-"
        unit = f" {last.unit}" if last.unit else ""
        lines.append(
            f"| {what} | {number(last.value)}{unit} | {bar} | {last.date}, {last.commit} |"
        )
    return "\n".join(lines)


def main() -> int:
    """Print what the file holds; returns the number of rows that have become worse."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.history", description=__doc__)
    parser.add_argument("--table", action="store_true", help="the table of docs/performance.md")
    options = parser.parse_args()
    found = entries(FILE.read_text(encoding="utf-8").splitlines())
    if options.table:
        print(table(found))
        return 0
    worse = 0
    for what, history in found.items():
        times = change(history)
        is_worse = times is not None and times >= WORSE
        worse += is_worse
        compared = "-" if times is None else f"{times:.2f} times as bad as before"
        last = history[-1]
        mark = "  WORSE" if is_worse else ""
        print(f"{what}: {number(last.value)} {last.unit} ({last.commit}), {compared}{mark}")
    return worse


def _stored(row: Row | Measurement) -> dict[str, Any]:
    if isinstance(row, Measurement):
        return {
            "what": row.what,
            "value": row.value,
            "unit": row.unit,
            "bar": row.limit,
            "larger_is_better": row.larger_is_better,
        }
    return {
        "what": row.what,
        "value": row.score,
        "unit": row.unit if row.peer is None else "x",
        "bar": row.at_least,
        "larger_is_better": row.larger_is_better,
    }


def _is_number(row: Row | Measurement) -> bool:
    return isinstance(row, Measurement) or row.verdict not in ("skipped", "FAILED")


if __name__ == "__main__":
    sys.exit(main())
