"""Differentiable MPM driven by the grid mass loss alone (algorithm 8.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import losses, optimization
from morph_engine.methods.method import FrameOutcome, Problem
from morph_engine.methods.mpm_method import MpmMethod, MpmOptions
from morph_engine.sections import (
    AdjointConfig,
    GridLossConfig,
    OptimizerConfig,
    RestartingWatchdogConfig,
    SmoothingConfig,
)

if TYPE_CHECKING:
    from morph_engine.losses import GridMassLoss
    from morph_engine.optimization import FrameOptimizer, FrameWeights


class ControlOptions(MpmOptions):
    """Options of the methods that control matter by gradients."""

    rest_volume: Literal["density", "lattice"] = Field(
        "density", description="Rest volumes from the density estimate of algorithm 1.3, or h^3."
    )
    smoothing: SmoothingConfig = SmoothingConfig()
    adjoint: AdjointConfig = AdjointConfig()
    grid_loss: GridLossConfig = GridLossConfig()
    optimizer: OptimizerConfig = OptimizerConfig()
    watchdog: RestartingWatchdogConfig = RestartingWatchdogConfig()


class PhysicsOptions(ControlOptions):
    """Matter flows under internal forces so that its mass on the grid becomes the target's."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        # closer to the target than the published settings, in less time: docs/presets.md
        "fast": {
            "material": {"drag": 4.0},
            "smoothing": {"late_frame": 12},
            "adjoint": {"drop_smoothing": True},
            "optimizer": {"layers_per_step": 3, "passes": 2, "step": 0.006, "far_distance": 0.5},
        },
        # what the authors' program does (algorithm 11.2, H0 of 7.3)
        "published": {
            "material": {"model": "fixed_corotated"},
            "adjoint": {"drop_smoothing": True, "carry_control": True, "drop_drag": True},
            "optimizer": {"shared_counter": True},
        },
        # the text of the paper taken literally (algorithm 11)
        "paper": {
            "time": {"transitions_per_frame": 10},
            "smoothing": {"values": (0.955,), "first_frames": (0,)},
            "grid_loss": {"outside_factor": 1.0},
        },
    }

    name: Literal["physics"] = "physics"


ControlOptionsT = TypeVar("ControlOptionsT", bound=ControlOptions)


class ControlMethod(MpmMethod[ControlOptionsT], Generic[ControlOptionsT]):
    """Matter whose deformation is controlled frame by frame, so that a loss falls."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        config, options = problem.config, self.options
        n = len(problem.source)
        target = self.device.upload(problem.target)
        self._rest_volume = (
            losses.GridMass(n, self._mass, self._grid).rest_volumes(
                self.device.upload(problem.source)
            )
            if options.rest_volume == "density"
            else np.full(n, config.spacing**3, self.device.numpy_real)
        )
        self._simulation = self._make_simulation(
            self._rest_volume,
            transitions=options.time.transitions_per_frame,
            adjoint=options.adjoint,
        )
        self._control = self._make_control(
            losses.GridMassLoss(
                target,
                particle_count=n,
                point_mass=self._mass,
                grid=self._grid,
                outside_factor=options.grid_loss.outside_factor,
            )
        )

    def advance(self, frame: int) -> FrameOutcome:
        """Optimise the control of one frame and carry its last layer on (algorithm 6.4)."""
        simulation = self._simulation
        order = self._cell_order()
        simulation.volume.from_numpy(self._rest_volume[order])
        first, last = simulation.layers[0], simulation.last
        first.upload(self._particles, order)
        self._matches.rebuild(first.x)
        self._matches.update(first.x)
        distance = two_sided(*self._matches.distances())
        report = self._control.run(frame, self._weights(frame), distance)
        self._matches.update(last.x)
        self._keep(last, order)
        numbers = {
            "loss_physics": report.losses.physics,
            "loss_chamfer": report.losses.chamfer,
            "accepted_steps": float(report.accepted),
            "failed_steps": float(report.failed),
            "dt": report.dt,
        }
        return self._outcome(order, numbers, tuple(report.events))

    def _make_control(self, grid_loss: GridMassLoss) -> FrameOptimizer:
        """What improves the control of a frame."""
        return optimization.FrameOptimizer(
            self._simulation,
            grid_loss,
            config=self.options.optimizer,
            restarts=self.options.watchdog.restarts,
        )

    def _weights(self, frame: int) -> FrameWeights:
        """The scheduled numbers of a frame."""
        return optimization.physics_weights(self.options.smoothing, frame)


class Physics(ControlMethod[PhysicsOptions]):
    """The grid mass loss alone."""


def two_sided(forward: NDArray[np.float64], reverse: NDArray[np.float64]) -> float:
    """Root of the sum of both mean squared distances [dx] (algorithm 9)."""
    return float(np.sqrt(np.mean(forward**2) + np.mean(reverse**2)))
