"""Direct optimisation of the published density-weighted Chamfer distance (algorithm 8.3)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from morph_engine.losses.weighted_chamfer import WeightedChamfer, density_weights
from morph_engine.methods.point_optimization import PointOptimisation
from morph_engine.methods.protocol import Problem


class Dcd(PointOptimisation):
    """Direct Chamfer optimisation in which points weigh by the density around them."""

    name: ClassVar[str] = "dcd"
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

    def _make_loss(self) -> WeightedChamfer:
        return WeightedChamfer(self._matches)

    def _begin(self, frame: int) -> None:
        if frame % self.problem.config.density.refresh_frames == 0:
            self._weigh(self._weights(self._x.to_numpy()))

    def _weights(self, points: NDArray[Any]) -> NDArray[np.float64]:
        density = self.problem.config.density
        return density_weights(points, density.neighbors, density.weighting)

    def _weigh(self, particles: NDArray[np.float64]) -> None:
        self._of_particles = particles
        self._loss.weigh(particles, self._of_targets)
