"""Chamfer distance over displacements that all points share (algorithm 8.6)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.losses.weighted_chamfer import WeightedChamfer
from morph_engine.methods.point_optimization import PointOptimisation
from morph_engine.optimization.amsgrad import AMSGrad
from morph_engine.optimization.control_lattice import ControlLattice


class SharedBasis(PointOptimisation):
    """Chamfer distance over a smooth field of displacements: control points on a lattice."""

    name: ClassVar[str] = "shared_basis"

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, the optimiser's state, and the control displacements, shape [c, 3]."""
        return {**super().state(), "control": self._control.to_numpy()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        super().restore(state)
        self._control.from_numpy(state["control"])

    def _make_loss(self) -> WeightedChamfer:
        return WeightedChamfer(self._matches)

    def _make_optimizer(self) -> AMSGrad:
        device, basis = backend.active(), self.problem.config.basis
        self._source = self.problem.source.astype(device.numpy_real)
        self._lattice = ControlLattice(self._source, basis.cells, device.numpy_real)
        self._control = device.vectors(self._lattice.count)
        self._control_gradient = device.vectors(self._lattice.count)
        return self._amsgrad(self._lattice.count, basis.learning_rate)

    def _move(self) -> None:
        """One step of the control points, which carries all particles along."""
        self._control_gradient.from_numpy(self._lattice.gradient(self._gradient.to_numpy()))
        self._optimizer.step(self._control, self._control_gradient)
        displacement = self._lattice.displacements(self._control.to_numpy())
        with np.errstate(invalid="ignore", over="ignore"):  # `advance` looks at the outcome
            self._x.from_numpy(self._source + displacement)
