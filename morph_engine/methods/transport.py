"""Optimal transport carried out by matter: every particle steers to a destination of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import mpm, optimal_transport
from morph_engine.errors import SimulationError
from morph_engine.methods.method import FrameOutcome, Problem
from morph_engine.methods.mpm_method import MpmMethod, MpmOptions
from morph_engine.methods.options import CostRates
from morph_engine.sections import NonNegative
from morph_engine.smoothstep import smoothstep

CELLS_PER_STEP = 0.2
"""What the fastest particle moves in a time step, at most [cells]."""

COURANT = 0.4
"""What an elastic wave travels in a time step, at most [cells]."""

STEEPEST = 1.5
"""Largest slope of `smoothstep`."""


class TransportOptions(MpmOptions):
    """Matter is steered to destinations that fill the target evenly, by optimal transport.

    How destinations are chosen and particles get there: docs/transport.md.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "fast": {"material": {"drag": 4.0}},
        "published": {"material": {"model": "fixed_corotated"}},
    }
    cost: ClassVar[CostRates] = CostRates(9e-6, 2e-6, 0.85, 0.2, bytes_per_node=18)
    fixed: ClassVar[tuple[str, ...]] = ("frames", "rest", "destinations", "sweeps", "group")

    name: Literal["transport"] = "transport"
    destinations: Literal["even", "random"] = Field(
        "even", description="Spread evenly over the target, or drawn at random from its points."
    )
    sweeps: int = Field(
        8,
        ge=0,
        description="Rounds in which neighbours exchange destinations to shorten their paths.",
    )
    group: int = Field(
        100, ge=2, le=2000, description="Number of particles that exchange at a time."
    )
    rest: float = Field(
        0.1,
        ge=0,
        lt=1,
        description="Share of the frames, at the end, during which the shape rests.",
    )
    correction: NonNegative = Field(
        0.03,
        description="Largest movement of a particle per step beyond the motion of the grid [h].",
    )

    def share_of_change(self, frame: float, frames: int) -> float:
        """Begins and ends at rest."""
        return smoothstep(frame / ((1 - self.rest) * frames))


class Transport(MpmMethod[TransportOptions]):
    """Optimal transport first, then motion that the grid shares.

    Before the first frame each particle gets a destination of its own, such that destinations
    fill the target evenly and the sum of squared distances is nearly the least possible. On the way
    matter moves as one: velocities pass through the grid, where neighbours share them, and pressure
    acts against changes of volume. What the grid is too coarse for is mended by small moves.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        volume = np.full(len(problem.source), problem.config.spacing**3)
        self._simulation = self._make_simulation(volume, transitions=1)
        self._destination: NDArray[np.float32] | None = None
        self._begin, self._end = (self.device.vectors(len(problem.source)) for _ in range(2))
        self._corrected = self.device.scalars(len(problem.source))
        time = self.options.time
        self._frame_seconds = time.dt * time.transitions_per_frame

    def advance(self, frame: int) -> FrameOutcome:
        """Carry every particle along the next part of its path.

        Raises:
            SimulationError: A particle is lost.
        """
        device, simulation, options = self.device, self._simulation, self.options
        if self._destination is None:
            self._destination = self._plan()
        goal = self._destination
        order = self._cell_order()
        begin, destination, corrected = self._begin, self._end, self._corrected
        begin.from_numpy(self.problem.source[order].astype(device.numpy_real))
        destination.from_numpy(goal[order].astype(device.numpy_real))
        corrected.fill(0)
        simulation.layers[0].upload(self._particles, order)
        steps = self._steps_per_frame(goal)
        simulation.dt = self._frame_seconds / steps
        limit = options.correction * self.problem.config.spacing
        for step in range(steps):
            moment = frame + (step + 1) / steps
            share = options.share_of_change(moment, self.problem.config.frames)
            here, there = simulation.layers
            mpm.steering.steer(here.x, here.v, here.F, begin, destination, share, simulation.dt)
            faults = simulation.forward()
            if faults:
                names = ", ".join(mpm.fault_names(faults))
                raise SimulationError.after(
                    frame, names, "try more `frames`, or `time.transitions_per_frame`"
                )
            mpm.steering.correct(there.x, corrected, begin, destination, share, limit)
            simulation.layers.reverse()
        last = simulation.layers[0]
        self._matches.rebuild(last.x)
        self._matches.update(last.x)
        self._keep(last, order)
        place = self.problem.source + share * (goal - self.problem.source)
        squared = np.sum((place - self._particles.x) ** 2, axis=1, dtype=np.float64)
        numbers = {
            "loss_transport": float(np.mean(squared)),
            "correction": float(corrected.to_numpy().mean(dtype=np.float64)),
            "dt": simulation.dt,
        }
        return self._outcome(order, numbers)

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, velocities, affine velocities, deformation gradients and destinations."""
        destination = {} if self._destination is None else {"destination": self._destination}
        return super().state() | destination

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        super().restore(state)
        self._destination = state.get("destination")

    def _plan(self) -> NDArray[np.float32]:
        """Destination of each particle [dx], shape [n, 3]."""
        config, options = self.problem.config, self.options
        source = self.problem.source.astype(np.float64)
        target = self.problem.target.astype(np.float64)
        if options.destinations == "even":
            destinations = optimal_transport.even_destinations(
                target, len(source), config.spacing, config.seed
            )
        else:
            destinations = optimal_transport.random_destinations(target, len(source), config.seed)
        plan = optimal_transport.transport_plan(
            source,
            destinations,
            sweeps=options.sweeps,
            group=options.group,
            seed=config.seed,
        )
        return destinations[plan].astype(np.float32)

    def _steps_per_frame(self, goal: NDArray[np.float32]) -> int:
        """As many as the configuration asks for, or more for fast particles and stiff matter."""
        config, options = self.problem.config, self.options
        farthest = float(np.linalg.norm(goal - self.problem.source, axis=1).max())
        frames = (1 - options.rest) * config.frames
        cells = STEEPEST * farthest / frames / config.grid.dx
        waves = self._frame_seconds * options.material.sound_speed / config.grid.dx
        least = max(cells / CELLS_PER_STEP, waves / COURANT)
        return max(options.time.transitions_per_frame, math.ceil(least))
