"""Sliced Wasserstein distance without physics (docs/method.md)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from morph_engine.losses.sliced_wasserstein import SlicedWasserstein
from morph_engine.methods.point_optimization import PointOptimisation


class Swd(PointOptimisation):
    """No physics and no nearest neighbours: points descend the sliced Wasserstein distance."""

    name: ClassVar[str] = "swd"

    _loss: SlicedWasserstein

    def _make_loss(self) -> SlicedWasserstein:
        directions = self.problem.config.sliced.directions
        return SlicedWasserstein(self.problem.target.astype(np.float64), self._x, directions)

    def _begin(self, frame: int) -> None:
        self._lines = np.random.default_rng((self.problem.config.seed, frame))

    def _differentiate(self) -> None:
        self._loss.turn(self._lines)
        super()._differentiate()
