"""Differentiable MPM driven by the grid mass loss alone (algorithm 8.1)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.losses.chamfer import ChamferLoss
from morph_engine.losses.grid_mass import GridMass, GridMassLoss
from morph_engine.losses.matches import Matches
from morph_engine.methods.protocol import FrameOutcome, Method, Problem
from morph_engine.mpm.grid import cell_order
from morph_engine.mpm.simulation_setup import make_grid, make_simulation, particle_mass
from morph_engine.mpm.state import Particles
from morph_engine.optimization.frame_optimizer import FrameOptimizer, FrameReport
from morph_engine.optimization.schedule import frame_weights


class Physics(Method):
    """Matter flows under internal forces so that its mass on the grid becomes the target's."""

    name: ClassVar[str] = "physics"
    with_chamfer: ClassVar[bool] = False

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        config = problem.config
        device = backend.active()
        n = len(problem.source)
        mass = particle_mass(config)
        grid = make_grid(config)
        self._grid = grid
        self._mass = mass
        self._particles = Particles.at_rest(problem.source.astype(device.numpy_real))
        source, target = device.upload(problem.source), device.upload(problem.target)
        self._rest_volume = (
            GridMass(n, mass, grid).rest_volumes(source)
            if config.sampling.rest_volume == "density"
            else np.full(n, config.spacing**3, device.numpy_real)
        )
        self._simulation = make_simulation(
            config, self._rest_volume, transitions=config.time.transitions_per_frame
        )
        self._matches = Matches(target, source)
        self._control = FrameOptimizer(
            self._simulation,
            GridMassLoss(
                target,
                particle_count=n,
                point_mass=mass,
                grid=grid,
                outside_factor=config.grid_loss.outside_factor,
            ),
            ChamferLoss(self._matches, config.chamfer, grid) if self.with_chamfer else None,
            config,
        )

    def advance(self, frame: int) -> FrameOutcome:
        """Optimise the control of one frame and carry its last layer on (algorithm 6.4)."""
        simulation = self._simulation
        order = cell_order(self._particles.x, self._grid)
        simulation.volume.from_numpy(self._rest_volume[order])
        simulation.layers[0].upload(self._particles.permuted(order))
        self._matches.rebuild(simulation.layers[0].x)
        weights = frame_weights(self.problem.config, frame, with_chamfer=self.with_chamfer)
        self._matches.update(simulation.layers[0].x)
        report = self._control.run(frame, weights, two_sided(*self._matches.distances()))
        self._matches.update(simulation.last.x)
        d_fwd, d_rev = self._matches.distances()
        original = np.argsort(order)
        self._particles = simulation.last.download().permuted(original)
        return FrameOutcome(
            positions=self._particles.x.astype(np.float32),
            d_fwd=d_fwd[original],
            nearest_fwd=self._matches.forward.to_numpy()[original],
            d_rev=d_rev,
            deformation=self._particles.F,
            numbers=self._numbers(report),
            events=tuple(report.events),
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, velocities, affine velocities and deformation gradients."""
        p = self._particles
        return {"x": p.x, "v": p.v, "C": p.C, "F": p.F}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        self._particles = Particles(**state)

    def _numbers(self, report: FrameReport) -> dict[str, float]:
        speed_squared = np.sum(self._particles.v.astype(np.float64) ** 2, axis=1)
        return {
            "loss_physics": report.losses.physics,
            "loss_chamfer": report.losses.chamfer,
            "kinetic_energy": float(0.5 * self._mass * speed_squared.sum()),
            "max_speed": float(np.sqrt(speed_squared.max())),
            "accepted_steps": float(report.accepted),
            "failed_steps": float(report.failed),
            "dt": report.dt,
        }


def two_sided(forward: NDArray[np.float64], reverse: NDArray[np.float64]) -> float:
    """Root of the sum of both mean squared distances [dx] (algorithm 9)."""
    return float(np.sqrt(np.mean(forward**2) + np.mean(reverse**2)))
