"""Measure the service: `python -m benchmarks.service [--json] [--record] [group ...]`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from benchmarks import history
from benchmarks.record import document, machine
from benchmarks.service import fairness, first_frame, latency, load, throughput
from benchmarks.service.local_service import LocalService
from benchmarks.service.measurement import table

GROUPS = {
    "latency": latency.measure,
    "first-frame": first_frame.measure,
    "throughput": throughput.measure,
    "fairness": fairness.measure,
    "load": load.measure,
}


def main() -> int:
    """Measure the chosen groups one after the other and print the table.

    Returns:
        Exit status: the number of figures above their limit.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.service", description=__doc__)
    parser.add_argument("groups", nargs="*", metavar="group", help=", ".join(GROUPS))
    parser.add_argument("--database", default="", help="URL of an empty Postgres database")
    parser.add_argument("--json", action="store_true", help="one JSON document instead")
    parser.add_argument("--record", action="store_true", help="add it to results/history.jsonl")
    options = parser.parse_args()
    unknown = set(options.groups) - GROUPS.keys()
    if unknown:
        parser.error(f"no group {', '.join(sorted(unknown))}; there are {', '.join(GROUPS)}")
    figures = []
    for group in options.groups or GROUPS:
        sys.stderr.write(f"measuring {group} ...\n")
        with tempfile.TemporaryDirectory(prefix="morph-service-") as folder:
            figures += GROUPS[group](LocalService(Path(folder), options.database))
    database = "Postgres" if options.database else "SQLite"
    if options.record:
        history.record(figures, database=database)
    if options.json:
        sys.stdout.write(document([asdict(figure) for figure in figures], database=database))
    else:
        print(f"{machine()}, {database}\n\n{table(figures)}")
    return sum(figure.missed for figure in figures)


if __name__ == "__main__":
    sys.exit(main())
