"""Chamfer distance over displacements that all points share (algorithm 8.6)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import optimization
from morph_engine.methods.options import CostRates
from morph_engine.methods.point_optimization import PointOptimization, PointOptions
from morph_engine.sections import DescentConfig, Positive

if TYPE_CHECKING:
    from morph_engine.optimization import AMSGrad


class ControlDescentConfig(DescentConfig):
    """Descent on the control points, by AMSGrad (algorithm 8.2)."""

    learning_rate: Positive = Field(
        0.03, description="Learning rate of AMSGrad on the control points [grid units]."
    )


class SharedBasisOptions(PointOptions):
    """Chamfer distance over a smooth field of displacements: control points on a lattice."""

    cost: ClassVar[CostRates] = CostRates(20e-6, 5e-6, 1.3, 0.3)
    fixed: ClassVar[tuple[str, ...]] = ("cells",)

    name: Literal["shared_basis"] = "shared_basis"
    cells: int = Field(8, ge=1, le=64, description="Cells along the source's longest side.")
    descent: ControlDescentConfig = ControlDescentConfig()


class SharedBasis(PointOptimization[SharedBasisOptions]):
    """Chamfer distance, whose gradient moves the control points of a lattice."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, the optimiser's state, and the control displacements, shape [c, 3]."""
        return {**super().state(), "control": self._control.to_numpy()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        super().restore(state)
        self._control.from_numpy(state["control"])

    def _make_optimizer(self) -> AMSGrad:
        device = self.device
        self._source = self.problem.source.astype(device.numpy_real)
        self._lattice = optimization.ControlLattice(
            self._source, self.options.cells, device.numpy_real
        )
        self._control = device.vectors(self._lattice.count)
        self._control_gradient = device.vectors(self._lattice.count)
        return self._amsgrad(self._lattice.count)

    def _move(self) -> None:
        """One step of the control points, which carries all particles along."""
        self._control_gradient.from_numpy(self._lattice.gradient(self._gradient.to_numpy()))
        self._optimizer.step(self._control, self._control_gradient)
        displacement = self._lattice.displacements(self._control.to_numpy())
        with np.errstate(invalid="ignore", over="ignore"):  # `advance` looks at the outcome
            self._x.from_numpy(self._source + displacement)
