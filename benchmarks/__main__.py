"""Print the table of the bar: `python -m benchmarks [--quick] [--json] [--record] [group ...]`."""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from benchmarks import history
from benchmarks.benchmark_groups import MODULES, measure
from benchmarks.comparison import Row, failed, table
from benchmarks.record import document, machine


def main() -> None:
    """Measure the chosen groups, each in a process of its own, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("groups", nargs="*", metavar="group", help=", ".join(MODULES))
    parser.add_argument("--quick", action="store_true", help="fewer repeats, no whole job")
    parser.add_argument("--json", action="store_true", help="one JSON document instead")
    parser.add_argument("--record", action="store_true", help="add it to results/history.jsonl")
    options = parser.parse_args()
    unknown = set(options.groups) - set(MODULES)
    if unknown:
        parser.error(f"no group {', '.join(sorted(unknown))}; there are {', '.join(MODULES)}")

    rows = []
    for group in options.groups or MODULES:
        sys.stderr.write(f"measuring {group} ...\n")
        rows += measured(group, options.quick)
    if options.record:
        history.record(rows)
    if options.json:
        sys.stdout.write(document([row.document() for row in rows]))
    else:
        sys.stdout.write(f"{machine()}\n\n{table(rows)}\n")
    sys.exit(any(row.verdict == "FAILED" for row in rows))


def measured(group: str, quick: bool) -> list[Row]:
    """Rows of a group, from a fresh process that shares no runtime with the others."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(measure, group, quick).result()
    except Exception as error:  # a crash of one group must not hide the others
        return [failed(group, f"{type(error).__name__}: {error}")]


if __name__ == "__main__":
    main()
