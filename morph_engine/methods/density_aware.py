"""Direct optimisation of the density-aware Chamfer distance of Wu et al. (algorithm 8.5)."""

from __future__ import annotations

from typing import ClassVar

from morph_engine.losses.density_aware_chamfer import DensityAwareChamfer
from morph_engine.methods.point_optimization import PointOptimisation


class DensityAware(PointOptimisation):
    """Direct optimisation of the distance of Wu et al., which shares out crowded matches."""

    name: ClassVar[str] = "density_aware"

    def _make_loss(self) -> DensityAwareChamfer:
        return DensityAwareChamfer(self._matches, self.problem.config.density.alpha)
