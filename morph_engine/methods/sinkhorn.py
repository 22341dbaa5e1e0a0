"""Sinkhorn divergence without physics (docs/transport.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from numpy.typing import NDArray
from pydantic import Field

from morph_engine import losses, mpm
from morph_engine.methods.options import CostRates
from morph_engine.methods.point_optimization import PointOptimization, PointOptions
from morph_engine.sections import Count, Kernel, Positive

if TYPE_CHECKING:
    from morph_engine.losses import SinkhornDivergence


class SinkhornOptions(PointOptions):
    """No physics and no nearest neighbours: points descend entropic optimal transport."""

    # its work is on the nodes
    cost: ClassVar[CostRates] = CostRates(6e-6, 6e-6, 0.5, 0.2, seconds_per_frame=8.3)
    fixed: ClassVar[tuple[str, ...]] = ("kernel",)

    name: Literal["sinkhorn"] = "sinkhorn"
    kernel: Kernel = Field("cubic", description="B-spline interpolation.")
    blur: Positive = Field(
        1.0, description="Length below which masses are not distinguished [grid units]."
    )
    rounds: Count = Field(2, description="Rounds of updates of the potentials per step.")


class Sinkhorn(PointOptimization[SinkhornOptions]):
    """Sinkhorn divergence of particles and target on the nodes of the grid."""

    _loss: SinkhornDivergence

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, the optimiser's state and the potentials, each of shape [node_count]."""
        return {**super().state(), **self._loss.state()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        super().restore(state)
        self._loss.restore(state)

    def _make_loss(self) -> SinkhornDivergence:
        options = self.options
        return losses.SinkhornDivergence(
            self.device.upload(self.problem.target),
            self._x,
            grid=mpm.make_grid(self.problem.config.grid, options.kernel),
            blur=options.blur,
            rounds=options.rounds,
        )
