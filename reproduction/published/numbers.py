"""The numbers of the paper's tables (paper.csv), and of the published program (program.csv).

Metrics have the names and units of `morph_engine.metrics.definitions.METRICS`; shares are 0 to 1.
Numbers of the 2D experiment stand with it, in `chamfer_morph.reproduction.planar`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

Numbers = dict[str, float]

CHAMFER = ("s2t", "t2s", "two_sided")
TARGETS = ("Bunny", "Duck", "Cow", "Teapot")
SHAPES = ("Sphere", *TARGETS)


def _read(name: str, *keys: str) -> Iterator[tuple[list[str], Numbers]]:
    """The keys and the numbers of each line of a CSV file; empty cells are left out."""
    with Path(__file__).with_name(name).open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            values = [line.pop(key) for key in keys]
            yield values, {metric: float(text) for metric, text in line.items() if text}


PAPER: dict[str, dict[str, Numbers]] = {}
"""Printed numbers: experiment, row, metric."""

for (_experiment, _row), _numbers in _read("paper.csv", "experiment", "row"):
    PAPER.setdefault(_experiment, {})[_row] = _numbers

PROGRAM: dict[str, Numbers] = {run: numbers for (run,), numbers in _read("program.csv", "run")}
"""What the published program yields by run id: its own output at frame 39 for `physics` and
`joint`, an independent repetition with its settings for `dco` and `dcd` (algorithm 8.2, 9.2)."""

CLAIMS: dict[str, float] = {
    "pairs_two_sided": 16,
    "pairs_s2t": 20,
    "sphere_mean_s2t_change": -0.108,
    "shapes_dco_worse": 3,
    "regularisers_worse": 4,
    "dragon_gain": 2.5,
}
"""What the paper concludes, as numbers."""
