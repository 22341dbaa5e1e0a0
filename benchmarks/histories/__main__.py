"""Play histories: `python -m benchmarks.histories --count 1000000 --first 0 --on memory`.

A history that breaks a rule is named by its number, and `--first NUMBER --count 1` repeats it.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from benchmarks.histories.grounds import DatabaseGround, MemoryGround
from benchmarks.histories.history import Violation, World

GROUNDS = {"memory": MemoryGround, "sqlite": DatabaseGround}


def main() -> int:
    """Play histories and print what came of it; returns 1 if any broke a rule."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.histories", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first history")
    parser.add_argument("--on", choices=GROUNDS, default="sqlite", help="where jobs are kept")
    options = parser.parse_args()
    logging.disable(logging.WARNING)  # each adoption would be told
    broken, cpu = 0, time.process_time()
    with (
        tempfile.TemporaryDirectory() as name,
        closing(World(GROUNDS[options.on](Path(name)))) as world,
    ):
        for number in range(options.first, options.first + options.count):
            try:
                world.play(number)
            except Violation as violation:
                broken += 1
                print(violation, flush=True)
    each = (time.process_time() - cpu) / options.count * 1e3
    print(f"{options.count} histories, {each:.2f} ms of CPU time each, {broken} broke a rule")
    return min(broken, 1)


if __name__ == "__main__":
    sys.exit(main())
