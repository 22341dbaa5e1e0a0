"""Direct Chamfer optimisation, with local regularizers where they have weight (8.2, 8.4)."""

from __future__ import annotations

from typing import Literal

from morph_engine import losses
from morph_engine.methods.method import Problem
from morph_engine.methods.point_optimization import PointOptimization, PointOptions
from morph_engine.sections import RegularizerConfig


class DcoOptions(PointOptions):
    """No physics: each point descends the Chamfer distance on its own, optionally regularised."""

    name: Literal["dco"] = "dco"
    regularizers: RegularizerConfig = RegularizerConfig()


class Dco(PointOptimization[DcoOptions]):
    """Chamfer distance and local regularizers."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._regularizers = losses.Regularizers(problem.source, self.options.regularizers)

    def _begin(self, frame: int) -> None:
        self._regularizers.rebuild(self._x)

    def _value(self) -> float:
        return super()._value() + self._regularizers.value(self._x)

    def _differentiate(self) -> None:
        super()._differentiate()
        self._regularizers.add_gradient(self._x, self._gradient)
