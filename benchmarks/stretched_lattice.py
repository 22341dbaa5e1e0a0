"""What a stretch alone does to neighbours: how far any continuous motion can keep them.

    python -m benchmarks.stretched_lattice 3.1 1.15 0.28

A cubic lattice is turned at random and stretched along three axes, at the same density. Printed are
the share of the 12 nearest neighbours that each point keeps, and, after points closer than 0.95 of
the spacing have moved apart, that share and D2min in squares of the spacing
(`metrics.path.neighbor_metrics`): what it takes to be even again.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morph_engine.metrics.path import neighbor_metrics

Points = NDArray[np.float64]

EDGE = 32.0
"""Of the cube of stretched points that is looked at [spacings]."""

MARGIN = 3.0
"""Points so far around it are moved, too [spacings]."""

CLOSEST = 0.95
ROUNDS = 200
TRIALS = 3


def stretched(stretches: Points, turn: Rotation) -> tuple[Points, Points]:
    """Lattice points, turned, and where they are when stretched, in and around the cube."""
    reach = EDGE / 2 + MARGIN
    count = int(np.ceil(np.sqrt(3) * reach / stretches.min())) + 1
    axis = np.arange(-count, count + 1, dtype=float)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    before = turn.apply(lattice)
    after = before * stretches
    near = (np.abs(after) < reach).all(axis=1)
    return before[near], after[near]


def moved_apart(points: Points) -> Points:
    """Points of which none is much closer to another than may be."""
    points = points.copy()
    for _ in range(ROUNDS):
        first, second = cKDTree(points).query_pairs(CLOSEST, output_type="ndarray").T
        offset = points[first] - points[second]
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        move = offset * (CLOSEST - distance) / np.maximum(distance, 1e-6) / 4
        np.add.at(points, first, move)
        np.subtract.at(points, second, move)
    return points


def main() -> None:
    """Read the stretches and print what they leave."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stretched_lattice",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("stretches", nargs=3, type=float, help="scaled to a product of one")
    given = np.array(parser.parse_args().stretches)
    stretches = given / np.prod(given) ** (1 / 3)
    rows = []
    for trial in range(TRIALS):
        before, after = stretched(stretches, Rotation.random(random_state=trial))
        even = moved_apart(after)
        inner = (np.abs(after) < EDGE / 2).all(axis=1)
        rows.append(
            [
                neighbor_metrics(before[inner], after[inner], 1.0)["kept"],
                *(neighbor_metrics(before[inner], even[inner], 1.0)[n] for n in ("kept", "d2_min")),
            ]
        )
    kept, kept_even, d2_min = np.mean(rows, axis=0)
    print(f"neighbours kept {kept:.2f}, and when even again {kept_even:.2f}; D2min {d2_min:.2f}")


if __name__ == "__main__":
    main()
