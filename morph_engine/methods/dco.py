"""Direct Chamfer optimisation, with local regularisers where they have weight (8.2, 8.4)."""

from __future__ import annotations

from typing import ClassVar

from morph_engine.losses.regularizers import Regularizers
from morph_engine.losses.weighted_chamfer import WeightedChamfer
from morph_engine.methods.point_optimization import PointOptimisation
from morph_engine.methods.protocol import Problem


class Dco(PointOptimisation):
    """No physics: every point by itself descends the Chamfer distance, regularised if asked."""

    name: ClassVar[str] = "dco"

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._regularisers = Regularizers(problem.source, problem.config.regularisers)

    def _make_loss(self) -> WeightedChamfer:
        return WeightedChamfer(self._matches)

    def _begin(self, frame: int) -> None:
        self._regularisers.rebuild(self._x)

    def _value(self) -> float:
        return super()._value() + self._regularisers.value(self._x)

    def _differentiate(self) -> None:
        super()._differentiate()
        self._regularisers.add_gradient(self._x, self._gradient)
