"""Optimal transport carried out by matter: every particle steers to a place of its own."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.errors import SimulationError
from morph_engine.losses.matches import Matches
from morph_engine.methods.protocol import FrameOutcome, Method, Problem
from morph_engine.mpm import steering
from morph_engine.mpm.faults import fault_names
from morph_engine.mpm.grid import cell_order
from morph_engine.mpm.simulation_setup import make_simulation
from morph_engine.mpm.state import Particles
from morph_engine.optimal_transport import even_destinations, random_destinations, transport_plan

CELLS_PER_STEP = 0.2
"""What the fastest particle moves in a time step, at most [cells]."""

COURANT = 0.4
"""What an elastic wave travels in a time step, at most [cells]."""

STEEPEST = 1.5
"""Largest slope of `ease`."""


class Transport(Method):
    """Matter steers to evenly spread places, handed out by optimal transport; fills the target.

    Before the first frame each particle gets a destination of its own, such that destinations
    fill the target evenly and the sum of squared ways is nearly the least possible. On its way
    matter moves as one: velocities pass through the grid, where neighbours share them, and pressure
    acts against changes of volume. What the grid is too coarse for is mended by small moves.
    """

    name: ClassVar[str] = "transport"

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        config, device = problem.config, backend.active()
        volume = np.full(len(problem.source), config.spacing**3)
        self._simulation = make_simulation(config, volume, transitions=1)
        self._particles = Particles.at_rest(problem.source.astype(device.numpy_real))
        self._destination: NDArray[np.float32] | None = None
        self._matches = Matches(device.upload(problem.target), device.upload(problem.source))
        self._frame_seconds = config.time.dt * config.time.transitions_per_frame

    def advance(self, frame: int) -> FrameOutcome:
        """Carry every particle along the next part of its way.

        Raises:
            SimulationError: A particle is lost.
        """
        device, simulation = backend.active(), self._simulation
        if self._destination is None:
            self._destination = self._plan()
        goal = self._destination
        order = cell_order(self._particles.x, simulation.grid)
        original = np.argsort(order)
        begin = device.upload(self.problem.source[order])
        destination = device.upload(goal[order])
        corrected = device.scalars(len(order))
        simulation.layers[0].upload(self._particles.permuted(order))
        steps = self._steps_per_frame(goal)
        simulation.dt = self._frame_seconds / steps
        transport = self.problem.config.transport
        for step in range(steps):
            share = ease(
                (frame + (step + 1) / steps) / ((1 - transport.rest) * self.problem.config.frames)
            )
            here, there = simulation.layers
            steering.steer(here.x, here.v, here.F, begin, destination, share, simulation.dt)
            faults = simulation.forward()
            if faults:
                raise SimulationError(
                    f"Frame {frame} cannot go on: {', '.join(fault_names(faults))}.",
                    "Those before it are kept; use more frames, or time.transitions_per_frame.",
                )
            limit = transport.correction * self.problem.config.spacing
            steering.correct(there.x, corrected, begin, destination, share, limit)
            simulation.layers.reverse()
        x = simulation.layers[0].x
        self._matches.rebuild(x)
        self._matches.update(x)
        d_fwd, d_rev = self._matches.distances()
        self._particles = simulation.layers[0].download().permuted(original)
        return FrameOutcome(
            positions=self._particles.x.astype(np.float32),
            d_fwd=d_fwd[original],
            nearest_fwd=self._matches.forward.to_numpy()[original],
            d_rev=d_rev,
            deformation=self._particles.F,
            numbers=self._numbers(goal, share, corrected.to_numpy()),
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, velocities, affine velocities, deformation gradients and destinations."""
        p = self._particles
        destination = {} if self._destination is None else {"destination": self._destination}
        return {"x": p.x, "v": p.v, "C": p.C, "F": p.F, **destination}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        particles = dict(state)
        self._destination = particles.pop("destination", None)
        self._particles = Particles(**particles)

    def _plan(self) -> NDArray[np.float32]:
        """Destination of each particle [dx], shape [n, 3]."""
        config = self.problem.config
        source = self.problem.source.astype(np.float64)
        target = self.problem.target.astype(np.float64)
        if config.transport.places == "even":
            places = even_destinations(target, len(source), config.spacing, config.seed)
        else:
            places = random_destinations(target, len(source), config.seed)
        plan = transport_plan(
            source,
            places,
            sweeps=config.transport.sweeps,
            group=config.transport.group,
            seed=config.seed,
        )
        return places[plan].astype(np.float32)

    def _steps_per_frame(self, goal: NDArray[np.float32]) -> int:
        """As many as the configuration asks for, or more for fast particles and stiff matter."""
        config = self.problem.config
        farthest = float(np.linalg.norm(goal - self.problem.source, axis=1).max())
        frames = (1 - config.transport.rest) * config.frames
        cells = STEEPEST * farthest / frames / config.grid.dx
        waves = self._frame_seconds * config.material.sound_speed / config.grid.dx
        least = max(cells / CELLS_PER_STEP, waves / COURANT)
        return max(config.time.transitions_per_frame, math.ceil(least))

    def _numbers(
        self, goal: NDArray[np.float32], share: float, corrected: NDArray[Any]
    ) -> dict[str, float]:
        p, begin = self._particles, self.problem.source
        place = begin + share * (goal - begin)
        mass = self._simulation.material.particle_mass
        speed_squared = np.sum(p.v.astype(np.float64) ** 2, axis=1)
        return {
            "loss_transport": float(np.mean(np.sum((place - p.x) ** 2, axis=1, dtype=np.float64))),
            "correction": float(corrected.mean(dtype=np.float64)),
            "kinetic_energy": float(0.5 * mass * speed_squared.sum()),
            "max_speed": float(np.sqrt(speed_squared.max())),
            "dt": self._simulation.dt,
        }


def ease(time: float) -> float:
    """Share of the way after a share of the time: begins and ends at rest (3 t^2 - 2 t^3)."""
    t = min(time, 1.0)
    return t * t * (3 - 2 * t)
