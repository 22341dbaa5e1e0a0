"""One frame of differentiable MPM: forward through its layers, adjoint back through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.mpm.constitutive import FIXED_COROTATED, NEO_HOOKEAN
from morph_engine.mpm.grid import Grid
from morph_engine.mpm.grid_to_particles import grid_to_particles, grid_to_particles_adjoint
from morph_engine.mpm.particles_to_grid import particles_to_grid, particles_to_grid_adjoint
from morph_engine.mpm.private_grids import PrivateGrids
from morph_engine.mpm.state import Layer, Transition


@dataclass(frozen=True)
class Material:
    """Elastic matter in particles (algorithm 0).

    Attributes:
        model: NEO_HOOKEAN or FIXED_COROTATED.
        lame_lambda, lame_mu: Lame parameters.
        particle_mass: Mass of every particle.
        drag: Drag coefficient [1/s].
    """

    model: int
    lame_lambda: float
    lame_mu: float
    particle_mass: float
    drag: float


@dataclass(frozen=True)
class AdjointFlags:
    """Three departures of the published program from the exact adjoint (algorithm 4.6).

    Attributes:
        drop_smoothing: Leave (1 - s) out of the path from F to C.
        carry_control: Add s F_bar' to the control gradient.
        drop_drag: Leave the drag out of the derivative of the weights.
    """

    drop_smoothing: bool = False
    carry_control: bool = False
    drop_drag: bool = False


EXACT = AdjointFlags()
PUBLISHED = AdjointFlags(drop_smoothing=True, carry_control=True, drop_drag=True)


class Simulation:
    """The layers of one frame and the transitions between them.

    Args:
        rest_volume: Rest volumes [dx^3], shape [n].
        grid: Background grid.
        material: What the particles are made of.
        dt: Time step [s]; may be changed between frames.
        transitions: Time steps per frame, each with its own control.
        domain: Particles outside [-domain, domain]^3 count as a fault [dx].
        largest_cells_per_step: A particle that moves farther in a step is a fault [cells].
        adjoint: Which adjoint to use.
    """

    def __init__(
        self,
        rest_volume: NDArray[Any],
        *,
        grid: Grid,
        material: Material,
        dt: float,
        transitions: int,
        domain: float,
        largest_cells_per_step: float = 0.5,
        adjoint: AdjointFlags = EXACT,
    ) -> None:
        device = backend.active()
        n = len(rest_volume)
        self.particle_count = n
        self.grid = grid
        self.material = material
        self.dt = dt
        self.domain = domain
        self.largest_cells_per_step = largest_cells_per_step
        self.adjoint = adjoint
        self.smoothing = 0.0
        rotations = material.model == FIXED_COROTATED
        self.layers = [Layer(n) for _ in range(transitions + 1)]
        self.transitions = [
            Transition(n, grid.node_count, rotations=rotations) for _ in range(transitions)
        ]
        self.volume = device.upload(rest_volume)
        self.bar = Layer(n)
        self.private = PrivateGrids(n, grid)
        self._grid_bar = device.vectors(grid.node_count, 8)
        self._faults = device.integers(1)

    @property
    def last(self) -> Layer:
        """The state at the end of the frame."""
        return self.layers[-1]

    def forward(self, first: int = 0) -> int:
        """Simulate from layer `first` to the last one (algorithm 2).

        Returns:
            Fault bits (`faults.NON_FINITE`, ...) of all these steps; 0 when all is well.
        """
        p, private = self.material, self.private
        self._faults[0] = 0
        for k in range(first, len(self.transitions)):
            here, there, step = self.layers[k], self.layers[k + 1], self.transitions[k]
            particles_to_grid(
                here.x, here.v, here.C, here.F, step.U, step.R, self.volume,
                private.partial, private.touched, step.nodes,
                self.particle_count, p.particle_mass, p.lame_lambda, p.lame_mu, self.dt, p.drag,
                private.chunk_count, private.chunk_size, self.grid, p.model, private.atomic,
            )  # fmt: skip
            grid_to_particles(
                here.x, here.F, step.U, step.nodes, there.x, there.v, there.C, there.F,
                self._faults, self.particle_count, self.dt, self.smoothing, self.domain,
                self.largest_cells_per_step * self.grid.dx / self.dt, self.grid,
            )  # fmt: skip
        return int(self._faults[0])

    def backward(self, last: int = 0, *, decay: float = 1.0) -> None:
        """Adjoint sweep from the gradient in `self.bar` down to layer `last` (algorithm 4).

        Leaves control gradients in `transitions[k].U_bar` for k >= last and the gradient by the
        state of layer `last` in `self.bar`.

        Args:
            last: The lowest layer to reach.
            decay: Factor on the whole adjoint state after every transition (algorithm 7.3 H1).
        """
        p, private, flags = self.material, self.private, self.adjoint
        factor = 1.0 if flags.drop_smoothing else 1.0 - self.smoothing
        bar = self.bar
        for k in reversed(range(last, len(self.transitions))):
            here, there, step = self.layers[k], self.layers[k + 1], self.transitions[k]
            particles_to_grid_adjoint(
                here.x, here.F, step.U, bar.x, bar.v, bar.C, bar.F,
                private.partial, private.touched, step.nodes, self._grid_bar,
                self.particle_count, factor, self.dt,
                private.chunk_count, private.chunk_size, self.grid, private.atomic,
            )  # fmt: skip
            grid_to_particles_adjoint(
                here.x, here.v, here.C, here.F, step.U, step.R, there.C, there.v, self.volume,
                self._grid_bar, bar.x, bar.v, bar.C, bar.F, step.U_bar,
                self.particle_count, p.particle_mass, p.lame_lambda, p.lame_mu, self.dt, p.drag,
                self.smoothing, factor, 0.0 if flags.drop_drag else 1.0,
                1.0 if flags.carry_control else 0.0, decay, self.grid, p.model,
            )  # fmt: skip


__all__ = [
    "EXACT",
    "FIXED_COROTATED",
    "NEO_HOOKEAN",
    "PUBLISHED",
    "AdjointFlags",
    "Material",
    "Simulation",
]
