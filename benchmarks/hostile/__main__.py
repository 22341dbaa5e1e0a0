"""Run a trial: `python -m benchmarks.hostile NAME [--count N] [--database URL]`."""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
from pathlib import Path

from benchmarks.record import machine
from benchmarks.service.local_service import LocalService
from benchmarks.service.measurement import table

TRIALS = ("finished", "slow_sockets", "idle", "extreme", "reads", "bombs", "sweeps", "large_heads")
"""Each is a module with `COUNT`, of what it takes many, and `measure`."""


def main() -> int:
    """Run one trial and print its figures.

    Returns:
        Exit status: the number of figures above their limit.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hostile", description=__doc__)
    parser.add_argument("trial", choices=TRIALS)
    parser.add_argument("--count", type=int, help="of jobs, sockets, workers, as the trial has it")
    parser.add_argument("--database", default="", help="URL of an empty Postgres database")
    parser.add_argument("--pooler", default="", help="URL of the same database behind a pooler")
    options = parser.parse_args()
    trial = importlib.import_module(f"benchmarks.hostile.{options.trial}")
    with tempfile.TemporaryDirectory(prefix="morph-hostile-") as folder:
        service = LocalService(Path(folder), options.database, options.pooler)
        figures = trial.measure(service, options.count or trial.COUNT)
        database = "Postgres" if options.database else "SQLite"
        print(f"{machine()}, {database}\n\n{table(figures)}", flush=True)
    return sum(figure.missed for figure in figures)


if __name__ == "__main__":
    sys.exit(main())
