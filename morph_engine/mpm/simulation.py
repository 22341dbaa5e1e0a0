"""One frame of differentiable MPM: forward through its layers, adjoint back through them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.mpm.constitutive import FIXED_COROTATED
from morph_engine.mpm.grid import Grid
from morph_engine.mpm.grid_to_particles import (
    GridToParticlesAdjointArrays,
    GridToParticlesArrays,
    grid_to_particles,
    grid_to_particles_adjoint,
)
from morph_engine.mpm.particles_to_grid import (
    ParticlesToGridAdjointArrays,
    ParticlesToGridArrays,
    particles_to_grid,
    particles_to_grid_adjoint,
)
from morph_engine.mpm.private_grids import PrivateGrids
from morph_engine.mpm.scheme import EXACT, Scheme
from morph_engine.mpm.state import Layer, Transition
from morph_engine.sections import AdjointConfig


@dataclass(frozen=True)
class Material:
    """Elastic matter in particles of one mass (algorithm 0); drag in 1/s.

    The model is NEO_HOOKEAN or FIXED_COROTATED.
    """

    model: int
    lame_lambda: float
    lame_mu: float
    particle_mass: float
    drag: float


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
        adjoint: AdjointConfig = EXACT,
    ) -> None:
        device = backend.active()
        n = len(rest_volume)
        self.particle_count = n
        self.grid: Grid = grid
        self.material = material
        self.dt = dt
        self.domain = domain
        self.largest_cells_per_step = largest_cells_per_step
        self.smoothing: float = 0.0
        rotations = material.model == FIXED_COROTATED
        self.layers: list[Layer] = [Layer(n) for _ in range(transitions + 1)]
        self.transitions: list[Transition] = [
            Transition(n, grid.node_count, rotations=rotations) for _ in range(transitions)
        ]
        self.volume: Any = device.upload(rest_volume)
        self._private = PrivateGrids(grid)
        self._scheme = Scheme(material.model, self._private.atomic, adjoint)
        self._faults = device.integers(1)
        self._packs: dict[tuple[Any, int], Any] = {}

    @cached_property
    def bar(self) -> Layer:
        """Gradients by the state of a layer; a run forwards alone has none."""
        return Layer(self.particle_count)

    @cached_property
    def _nodes_bar(self) -> Any:
        return backend.active().vectors(self.grid.node_count, 8)

    @property
    def last(self) -> Layer:
        """The state at the end of the frame."""
        return self.layers[-1]

    def forward(self, first: int = 0) -> int:
        """Simulate from layer `first` to the last one (algorithm 2).

        Returns:
            Fault bits (`faults.NON_FINITE`, ...) of all these steps; 0 when all is well.
        """
        self.clear_faults()
        for k in range(first, len(self.transitions)):
            self.to_nodes(k)
            self.to_particles(k)
        return self.faults

    def let_go(self, leaky: bool) -> None:
        """Whether the grid lets go of particles beyond its reach; kernels that do are slower."""
        self.grid = replace(self.grid, leaky=leaky)

    def outside(self, layer: Layer) -> int:
        """How many particles of a layer are outside [-domain, domain]^3."""
        reach = np.abs(layer.x.to_numpy()).max(axis=1)
        return int(np.count_nonzero(reach > self.domain))

    @property
    def faults(self) -> int:
        """Fault bits of the steps since `forward` began or `clear_faults`."""
        return int(self._faults[0])

    def clear_faults(self) -> None:
        """Forget faults, before steps made by `to_nodes` and `to_particles`."""
        self._faults.fill(0)

    def to_nodes(self, k: int = 0) -> None:
        """First half of time step k: velocity and mass in `transitions[k].nodes`."""
        p = self.material
        particles_to_grid(
            self._pack(ParticlesToGridArrays, k),
            p.particle_mass, p.lame_lambda, p.lame_mu, self.dt, p.drag, self.grid, self._scheme,
        )  # fmt: skip

    def to_particles(self, k: int = 0) -> None:
        """Second half of time step k: layer k + 1 from the node velocities."""
        largest_speed = self.largest_cells_per_step * self.grid.dx / self.dt
        grid_to_particles(
            self._pack(GridToParticlesArrays, k), self._faults,
            self.dt, self.smoothing, self.domain, largest_speed, self.grid,
        )  # fmt: skip

    def backward(self, last: int = 0, *, decay: float = 1.0) -> None:
        """Adjoint sweep from the gradient in `self.bar` down to layer `last` (algorithm 4).

        Leaves control gradients in `transitions[k].U_bar` for k >= last and the gradient by the
        state of layer `last` in `self.bar`.

        Args:
            last: The lowest layer to reach.
            decay: Factor on the whole adjoint state after every transition (algorithm 7.3 H1).
        """
        p = self.material
        factor = 1.0 if self._scheme.adjoint.drop_smoothing else 1.0 - self.smoothing
        for k in reversed(range(last, len(self.transitions))):
            particles_to_grid_adjoint(
                self._pack(ParticlesToGridAdjointArrays, k),
                factor, self.dt, self.grid, self._scheme,
            )  # fmt: skip
            grid_to_particles_adjoint(
                self._pack(GridToParticlesAdjointArrays, k),
                p.particle_mass, p.lame_lambda, p.lame_mu, self.dt, p.drag,
                self.smoothing, factor, decay, self.grid, self._scheme,
            )  # fmt: skip

    def _pack(self, kind: Any, k: int) -> Any:
        """Those arrays of time step k that a kernel works on, as one argument.

        Packs are kept, for making one takes a tenth of a millisecond; layers and controls may have
        been exchanged since.
        """
        here, there, private = self.layers[k], self.layers[k + 1], self._private
        transition = self.transitions[k]
        arrays = {
            "x": here.x, "v": here.v, "C": here.C, "F": here.F,
            "x_next": there.x, "v_next": there.v, "C_next": there.C, "F_next": there.F,
            "U": transition.U, "R": transition.R, "volume": self.volume,
            "nodes": transition.nodes, "partial": private.partial, "touched": private.touched,
        }  # fmt: skip
        if "nodes_bar" in kind.members:
            bar = self.bar
            arrays |= {
                "x_bar": bar.x, "v_bar": bar.v, "C_bar": bar.C, "F_bar": bar.F,
                "U_bar": transition.U_bar, "nodes_bar": self._nodes_bar,
            }  # fmt: skip
        pack = self._packs.get((kind, k))
        if pack is None:
            pack = self._packs[kind, k] = kind(**{name: arrays[name] for name in kind.members})
        for name in kind.members:
            if pack[name] is not arrays[name]:
                pack[name] = arrays[name]
        return pack
