"""Your own method in one file: here, every particle walks straight to a target point of its own.

    python examples/own_method.py --frames 10

A method says how one frame follows from the last, what it must remember, and how to take that up
again; it then has the command line's settings, metrics, result file and resuming for nothing.
This one pairs particles and target points along one direction after another, so that few share a
point, and moves a fixed share of the way each frame.
"""

from __future__ import annotations

import argparse
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morph_engine import configure, morph
from morph_engine.config import MethodOptions
from morph_engine.methods import FrameOutcome, Method, Problem


class SortedOptions(MethodOptions):
    """Particles walk to target points of the same rank, slice by slice."""

    name: Literal["sorted"] = "sorted"


class Sorted(Method[SortedOptions]):
    """Straight ways between points of the same rank."""

    Options = SortedOptions

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._goal = problem.target[_partners(problem.source, problem.target)]
        self._positions = problem.source

    def advance(self, frame: int) -> FrameOutcome:
        """Walk one part of the rest of the way, all of it in the last frame."""
        rest = self.problem.config.frames - frame
        self._positions = self._positions + (self._goal - self._positions) / np.float32(rest)
        d_fwd, nearest = cKDTree(self.problem.target).query(self._positions)
        d_rev, _ = cKDTree(self._positions).query(self.problem.target)
        return FrameOutcome(self._positions, d_fwd, nearest.astype(np.int32), d_rev)

    def state(self) -> dict[str, NDArray[Any]]:
        """Where the particles are; the rest follows from the problem."""
        return {"positions": self._positions}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        self._positions = state["positions"]


def _partners(source: NDArray[Any], target: NDArray[Any], slabs: int = 20) -> NDArray[np.intp]:
    """A target point for each particle: of the same rank in z, then in y, then in x."""

    def ordered(points: NDArray[Any]) -> NDArray[np.intp]:
        rank = np.argsort(np.argsort(points[:, 2], kind="stable"))
        slab = rank * slabs // len(points)
        order = np.lexsort((points[:, 1], slab))
        row = np.empty(len(points), np.intp)
        row[order] = np.arange(len(points)) * slabs**2 // len(points)
        return np.lexsort((points[:, 0], row))

    here, there = ordered(source), ordered(target)
    partners = np.empty(len(source), np.intp)
    partners[here] = there[np.arange(len(source)) * len(target) // len(source)]
    return partners


def main() -> None:
    """Read the command line and run the method."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", default="sphere")
    parser.add_argument("--target", default="star")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--points", type=int, default=2, help="particles per grid cell edge")
    arguments = parser.parse_args()

    settings = {"frames": arguments.frames, "sampling.points_per_cell_edge": arguments.points}
    config = configure("fast", settings | {"method": "sorted"})
    for frame in morph(arguments.source, arguments.target, config):
        distance, distinct = frame.metrics["two_sided"], frame.metrics["many_to_one"]
        print(f"frame {frame.index:2}  Chamfer distance {distance:.3f} dx  distinct {distinct:.3f}")


if __name__ == "__main__":
    main()
