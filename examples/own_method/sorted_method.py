"""Your own method in one file: here, every particle walks straight to a target point of its own.

    pip install examples/own_method
    morph run sphere star --method sorted --set slabs=10

A method declares its settings, and says how one frame follows from the last, what it must remember
and how to take that up again; command line, service, metrics, result file and resuming are there
for nothing. This one pairs particles and target points along one direction after another, so that
few share a point.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from morph_engine.methods import CostRates, FrameOutcome, Method, MethodOptions, Problem

AXES = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 1, 0)}
"""Directions in which particles are sorted, one after another."""


class SortedOptions(MethodOptions):
    """Particles walk to target points of the same rank, slice by slice."""

    cost: ClassVar[CostRates] = CostRates(2e-6, 2e-6, 0.3, 0.2)

    name: Literal["sorted"] = "sorted"
    slabs: int = Field(20, ge=1, le=200, description="Slices, and rows in each of them.")
    first_axis: Literal["x", "y", "z"] = Field("z", description="Direction across the slices.")
    rest: float = Field(
        0.0, ge=0, lt=1, description="Share of the frames at the end without motion."
    )


class Sorted(Method[SortedOptions]):
    """Straight paths between points of the same rank."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._goal = problem.target[self._partners()]
        self._positions = problem.source

    def advance(self, frame: int) -> FrameOutcome:
        """Walk part of the remaining path, all of it in the last frame."""
        frames = max(1, round((1 - self.options.rest) * self.problem.config.frames))
        left = np.float32(max(1, frames - frame))
        self._positions = self._positions + (self._goal - self._positions) / left
        d_fwd, nearest = cKDTree(self.problem.target).query(self._positions)
        d_rev, _ = cKDTree(self._positions).query(self.problem.target)
        return FrameOutcome(self._positions, d_fwd, nearest.astype(np.int32), d_rev)

    def state(self) -> dict[str, NDArray[Any]]:
        """Where the particles are; the rest follows from the problem."""
        return {"positions": self._positions}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        self._positions = state["positions"]

    def _partners(self) -> NDArray[np.intp]:
        """A target point for each particle: of the same rank in one direction after another."""
        source, target = self.problem.source, self.problem.target
        here, there = self._ordered(source), self._ordered(target)
        partners = np.empty(len(source), np.intp)
        partners[here] = there[np.arange(len(source)) * len(target) // len(source)]
        return partners

    def _ordered(self, points: NDArray[Any]) -> NDArray[np.intp]:
        """Points slice by slice, in each of them row by row."""
        first, second, third = AXES[self.options.first_axis]
        slabs = self.options.slabs
        rank = np.argsort(np.argsort(points[:, first], kind="stable"))
        order = np.lexsort((points[:, second], rank * slabs // len(points)))
        row = np.empty(len(points), np.intp)
        row[order] = np.arange(len(points)) * slabs**2 // len(points)
        return np.lexsort((points[:, third], row))
