"""Direct optimisation of the published density-weighted Chamfer distance (algorithm 8.3)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import losses
from morph_engine.methods.method import Problem
from morph_engine.methods.point_optimization import PointOptimization, PointOptions
from morph_engine.sections import Count

if TYPE_CHECKING:
    from morph_engine.losses import WeightedChamfer


class DcdOptions(PointOptions):
    """Direct Chamfer optimisation with points weighted by the density around them."""

    name: Literal["dcd"] = "dcd"
    weighting: Literal["published", "inverse"] = Field(
        "published", description="Whether dense or sparse regions weigh more."
    )
    neighbors: int = Field(
        8, ge=1, le=64, description="Neighbours whose distance defines the density."
    )
    refresh_frames: Count = Field(5, description="Frames between updates of the weights.")


class Dcd(PointOptimization[DcdOptions]):
    """Chamfer distance with weights from the distance of neighbours."""

    _loss: WeightedChamfer

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._of_targets = self._weights(problem.target)
        self._weigh(self._weights(problem.source))

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, the optimiser's state, and the weights of the particles, shape [n]."""
        return {**super().state(), "weights": self._of_particles}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        super().restore(state)
        self._weigh(state["weights"])

    def _begin(self, frame: int) -> None:
        if frame % self.options.refresh_frames == 0:
            self._weigh(self._weights(self._x.to_numpy()))

    def _weights(self, points: NDArray[Any]) -> NDArray[np.float64]:
        options = self.options
        return losses.density_weights(points, options.neighbors, options.weighting)

    def _weigh(self, particles: NDArray[np.float64]) -> None:
        self._of_particles = particles
        self._loss.weigh(particles, self._of_targets)
