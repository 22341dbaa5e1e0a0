"""Sliced Wasserstein distance without physics (docs/transport.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from morph_engine import losses
from morph_engine.methods.options import CostRates
from morph_engine.methods.point_optimization import PointOptimization, PointOptions

if TYPE_CHECKING:
    from morph_engine.losses import SlicedWasserstein


class SwdOptions(PointOptions):
    """No physics and no nearest neighbours: points descend the sliced Wasserstein distance."""

    cost: ClassVar[CostRates] = CostRates(160e-6, 6e-6, 0.5, 0.2)

    name: Literal["swd"] = "swd"
    directions: int = Field(
        16, ge=1, le=1024, description="Lines to project onto, drawn anew in each step."
    )


class Swd(PointOptimization[SwdOptions]):
    """Sliced Wasserstein distance along lines that every step draws anew."""

    _loss: SlicedWasserstein

    def _make_loss(self) -> SlicedWasserstein:
        target = self.problem.target.astype(np.float64)
        return losses.SlicedWasserstein(target, self._x, self.options.directions)

    def _begin(self, frame: int) -> None:
        self._lines = np.random.default_rng((self.problem.config.seed, frame))

    def _differentiate(self) -> None:
        self._loss.turn(self._lines)
        super()._differentiate()
