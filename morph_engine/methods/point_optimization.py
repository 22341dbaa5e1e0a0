"""What the methods share that move points directly, without physics (algorithm 8.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from morph_engine import geometry, losses, optimization
from morph_engine.errors import SimulationError
from morph_engine.methods.method import FrameOutcome, Method, Problem
from morph_engine.methods.options import CostRates, MethodOptions
from morph_engine.sections import DescentConfig

if TYPE_CHECKING:
    from morph_engine.optimization import AMSGrad


class PointOptions(MethodOptions):
    """Options of every method that moves points directly."""

    cost: ClassVar[CostRates] = CostRates(6e-6, 5e-6, 0.4, 0.1)  # at 30 steps per frame

    descent: DescentConfig = DescentConfig()


PointOptionsT = TypeVar("PointOptionsT", bound=PointOptions)


class PointLoss(Protocol):
    """What is descended."""

    def value(self) -> float:
        """The loss at the particles as they are."""

    def gradient(self, x: Any, gradient: Any) -> None:
        """Set `gradient` [n, 3] to that at particles x [dx], shape [n, 3], device arrays."""


class PointOptimization(Method[PointOptionsT], Generic[PointOptionsT]):
    """A loss of the positions, descended by AMSGrad; a frame is a fixed number of steps.

    The optimiser's state is continuous over all frames. Nearest neighbours are exact and
    recomputed in every step.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        device = self.device
        self._x = device.upload(problem.source)
        self._gradient = device.vectors(len(problem.source))
        self._matches = losses.Matches(device.upload(problem.target), self._x)
        self._matches.update(self._x)
        self._loss = self._make_loss()
        self._optimizer = self._make_optimizer()

    def advance(self, frame: int) -> FrameOutcome:
        """Make the steps of one frame."""
        before = self.state()
        self._matches.rebuild(self._x)
        self._begin(frame)
        for _ in range(self.options.descent.steps_per_frame):
            self._differentiate()
            self._move()
            self._matches.update(self._x)
        positions = self._x.to_numpy()
        if not (np.abs(positions) <= geometry.REACH).all():
            self.restore(before)
            raise SimulationError.after(
                frame,
                "positions are not finite",
                "try a lower learning rate, or lower weights of the regularisers",
            )
        d_fwd, d_rev = self._matches.distances()
        return FrameOutcome(
            positions=positions.astype(np.float32),
            d_fwd=d_fwd,
            nearest_fwd=self._matches.forward.to_numpy(),
            d_rev=d_rev,
            numbers={"loss_points": self._value()},
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, shape [n, 3], and the optimiser's moments and steps."""
        return {"x": self._x.to_numpy(), **self._optimizer.state()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        self._x.from_numpy(state["x"])
        self._optimizer.restore(state)
        self._matches.rebuild(self._x)
        self._matches.update(self._x)

    def _make_loss(self) -> PointLoss:
        """The loss that is descended, by default the Chamfer distance."""
        return losses.WeightedChamfer(self._matches)

    def _make_optimizer(self) -> AMSGrad:
        """The optimiser of the variables, which are the positions."""
        return self._amsgrad(len(self.problem.source))

    def _amsgrad(self, count: int) -> AMSGrad:
        descent = self.options.descent
        return optimization.AMSGrad(
            count,
            learning_rate=descent.learning_rate,
            beta1=descent.beta1,
            beta2=descent.beta2,
            epsilon=descent.epsilon,
        )

    def _begin(self, frame: int) -> None:
        """Refresh what stays constant within a frame."""

    def _value(self) -> float:
        """What the method minimises, at the positions matched last."""
        return self._loss.value()

    def _differentiate(self) -> None:
        """Set the gradient by the positions."""
        self._loss.gradient(self._x, self._gradient)

    def _move(self) -> None:
        """Make one step."""
        self._optimizer.step(self._x, self._gradient)
