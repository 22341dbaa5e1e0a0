"""What the methods share that simulate particles as elastic matter on a grid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import losses, mpm
from morph_engine.methods.method import FrameOutcome, Method, Problem
from morph_engine.methods.options import CostRates, MethodConfig, MethodOptions
from morph_engine.mpm.grid_size import nodes_per_axis
from morph_engine.sections import (
    AdjointConfig,
    GridConfig,
    Kernel,
    MaterialConfig,
    TimeConfig,
    WatchdogConfig,
)

if TYPE_CHECKING:
    from morph_engine.mpm import Layer, Simulation
    from morph_engine.optimization import Event

COURANT_LIMIT = 1.0
"""An elastic wave crosses at most this many cells in a time step (Courant condition)."""


class MpmOptions(MethodOptions):
    """Options of every method that simulates matter."""

    kernel: Kernel = Field("cubic", description="B-spline interpolation.")
    material: MaterialConfig = MaterialConfig()
    time: TimeConfig = TimeConfig()
    watchdog: WatchdogConfig = WatchdogConfig()

    cost: ClassVar[CostRates] = MethodOptions.cost._replace(bytes_per_node=200)

    def node_count(self, config: MethodConfig, *, radius: float, ratio: float) -> int:
        """Nodes of the background grid."""
        return nodes_per_axis(config.grid.half_extent, config.grid.dx) ** 3

    def check_grid(self, grid: GridConfig) -> None:
        """Refuse time steps beyond the stable range of the material on the grid."""
        largest = COURANT_LIMIT * grid.dx / self.material.sound_speed
        if self.time.dt > largest:
            raise ValueError(
                f"time.dt = {self.time.dt:g} s exceeds the stability limit of "
                f"{largest:.4g} s for this material and grid"
            )
        self.check_drag(self.time.dt)

    def check_drag(self, dt: float) -> None:
        """Refuse drag that would turn velocities around in a time step [s]."""
        if self.material.drag * dt >= 1:
            raise ValueError(
                f"material.drag = {self.material.drag:g} / s is too large for time steps of "
                f"{dt:.4g} s: their product must be below 1"
            )


MpmOptionsT = TypeVar("MpmOptionsT", bound=MpmOptions)


class MpmMethod(Method[MpmOptionsT], Generic[MpmOptionsT]):
    """Particles with velocity and deformation, sorted by cell for every frame."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        config, device = problem.config, self.device
        self._mass = self.options.material.density * config.spacing**3
        self._grid = mpm.make_grid(config.grid, self.options.kernel)
        self._particles = mpm.Particles.at_rest(problem.source.astype(device.numpy_real))
        self._matches = losses.Matches(device.upload(problem.target), device.upload(problem.source))

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions, velocities, affine velocities and deformation gradients.

        They stay as they are: a frame makes new ones.
        """
        p = self._particles
        state = {"x": p.x, "v": p.v, "C": p.C, "F": p.F}
        for array in state.values():
            array.flags.writeable = False
        return state

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        self._particles = mpm.Particles(**{name: state[name] for name in "xvCF"})

    def _make_simulation(
        self,
        rest_volume: NDArray[Any],
        *,
        transitions: int,
        adjoint: AdjointConfig | None = None,
    ) -> Simulation:
        """A simulation of the material with rest volumes [dx^3], shape [n].

        So many transitions are kept at a time; the adjoint is exact if nothing else is given.
        """
        material = self.options.material
        return mpm.Simulation(
            rest_volume,
            grid=self._grid,
            material=mpm.Material(
                model=mpm.MODELS[material.model],
                lame_lambda=material.lame_lambda,
                lame_mu=material.lame_mu,
                particle_mass=self._mass,
                drag=material.drag,
            ),
            dt=self.options.time.dt,
            transitions=transitions,
            domain=self.problem.config.domain,
            largest_cells_per_step=self.options.watchdog.cells_per_step,
            adjoint=adjoint or mpm.EXACT,
        )

    def _cell_order(self) -> NDArray[np.intp]:
        """Particles by grid cell, shape [n]."""
        return mpm.cell_order(self._particles.x, self._grid)

    def _keep(self, layer: Layer, order: NDArray[np.intp]) -> None:
        """Take the state that a frame has ended with, whose particles are in this order."""
        self._particles = layer.download(mpm.inverse_order(order))

    def _outcome(
        self, order: NDArray[np.intp], numbers: dict[str, float], events: tuple[Event, ...] = ()
    ) -> FrameOutcome:
        """Report the state kept last, whose particles have this order on the device.

        Their matches must be up to date.
        """
        p, original = self._particles, mpm.inverse_order(order)
        d_fwd, d_rev = self._matches.distances()
        velocity = p.v.astype(np.float64)
        speed_squared = np.einsum("ij,ij->i", velocity, velocity)
        return FrameOutcome(
            positions=p.x.astype(np.float32),
            d_fwd=d_fwd[original],
            nearest_fwd=self._matches.forward.to_numpy()[original],
            d_rev=d_rev,
            deformation=p.F,
            numbers={
                **numbers,
                "kinetic_energy": float(0.5 * self._mass * speed_squared.sum()),
                "max_speed": float(np.sqrt(speed_squared.max())),
            },
            events=events,
        )
