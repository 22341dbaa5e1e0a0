"""Sinkhorn divergence without physics (docs/method.md)."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.losses.sinkhorn import SinkhornDivergence
from morph_engine.methods.point_optimization import PointOptimisation
from morph_engine.mpm.simulation_setup import make_grid


class Sinkhorn(PointOptimisation):
    """No physics and no nearest neighbours: points descend entropic optimal transport."""

    name: ClassVar[str] = "sinkhorn"

    _loss: SinkhornDivergence

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, the optimiser's state and the potentials, each of shape [node_count]."""
        return {**super().state(), **self._loss.state()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        super().restore(state)
        self._loss.restore(state)

    def _make_loss(self) -> SinkhornDivergence:
        config = self.problem.config
        return SinkhornDivergence(
            backend.active().upload(self.problem.target),
            self._x,
            grid=make_grid(config),
            blur=config.entropy.blur,
            rounds=config.entropy.rounds,
        )
