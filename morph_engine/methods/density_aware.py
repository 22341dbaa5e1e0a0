"""Direct optimisation of the density-aware Chamfer distance of Wu et al. (algorithm 8.5)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from morph_engine import losses
from morph_engine.methods.options import CostRates
from morph_engine.methods.point_optimization import PointOptimization, PointOptions
from morph_engine.sections import Positive

if TYPE_CHECKING:
    from morph_engine.losses import DensityAwareChamfer


class DensityAwareOptions(PointOptions):
    """Direct optimisation of the distance of Wu et al., which discounts crowded matches."""

    cost: ClassVar[CostRates] = CostRates(9e-6, 6e-6, 0.8, 0.4)

    name: Literal["density_aware"] = "density_aware"
    alpha: Positive = Field(0.2, description="Rate of decay with distance [1 / grid unit].")


class DensityAware(PointOptimization[DensityAwareOptions]):
    """Density-aware Chamfer distance."""

    def _make_loss(self) -> DensityAwareChamfer:
        return losses.DensityAwareChamfer(self._matches, self.options.alpha)
