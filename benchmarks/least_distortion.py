"""How little any matching of two bodies can change the shortest paths inside them.

    python -m benchmarks.least_distortion result.vtkhdf

Some particles of a result are drawn at random, and paths between them are measured inside the first
and the last body (`metrics.path.geodesic_distortion`). Gromov-Wasserstein transport looks for the
matching of these places, equal parts of the volume, that changes the paths least: the least of that
from the result's own matching and from none. It is a local minimum, as all that is known to find.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morph_engine.metrics.path import shortest_paths
from morph_engine.results.trajectory import Trajectory

DRAWN = 700
"""Particles: the time it takes grows with their cube."""

ROUNDS = 300


def distortion(before: NDArray[np.float64], after: NDArray[np.float64]) -> float:
    """Rms difference of paths over their mean before."""
    return float(np.sqrt(np.mean((after - before) ** 2)) / before.mean())


def least_distortion(before: NDArray[np.float64], after: NDArray[np.float64]) -> float:
    """The same for the best matching that is found, shape [k, k] both."""
    import ot

    count = len(before)
    even = np.full(count, 1 / count)
    costs = []
    for start in (np.diag(even), np.outer(even, even)):
        _, found = ot.gromov.gromov_wasserstein(
            before, after, even, even, "square_loss", G0=start, max_iter=ROUNDS, log=True
        )
        costs.append(found["gw_dist"])
    return float(np.sqrt(min(costs)) / before.mean())


def main() -> None:
    """Read the command line and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.least_distortion")
    parser.add_argument("result", type=Path)
    with Trajectory(parser.parse_args().result) as result:
        first, last = (result.positions(frame).astype(float) for frame in (0, -1))
        spacing = result.config.spacing
    drawn = np.random.default_rng(0).choice(len(first), min(DRAWN, len(first)), replace=False)
    before, after = (shortest_paths(points, drawn, spacing) for points in (first, last))
    own, least = distortion(before, after), least_distortion(before, after)
    print(f"the result {own:.3f}, least {least:.3f}")


if __name__ == "__main__":
    main()
