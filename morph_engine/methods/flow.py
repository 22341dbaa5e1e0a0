"""One body changes its shape, and incompressible matter flows inside it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import flow, geometry, kept_results, mpm
from morph_engine.errors import ConfigError, SimulationError
from morph_engine.flow.node_box import NodeBox
from morph_engine.methods.like_parts import Landmark, LikeParts
from morph_engine.methods.method import FrameOutcome, Problem
from morph_engine.methods.mpm_method import MpmMethod, MpmOptions
from morph_engine.methods.options import CostRates
from morph_engine.mpm.grid_size import nodes_per_axis
from morph_engine.optimization.watchdog import restarted
from morph_engine.sections import (
    Fraction,
    GridConfig,
    Kernel,
    MaterialConfig,
    NonNegative,
    Positive,
    RestartingWatchdogConfig,
)
from morph_engine.smoothstep import smoothstep
from morph_engine.spans import span

if TYPE_CHECKING:
    from morph_engine.flow import Body
    from morph_engine.geometry.mesh import Mesh
    from morph_engine.methods.options import MethodConfig
    from morph_engine.mpm import Material, Simulation

COURANT = 0.8
"""What an elastic shear wave travels in a time step, at most [cells]."""

WAVE_STEPS = 8
"""Time steps per frame that these waves may ask for. Where particles are so fine that they ask for
more, matter is softer than it should be; `steps_per_frame` makes it stiff again."""

CELLS_PER_STEP = 0.4
"""What the fastest particle shall move in a time step [cells]."""

STEPS = 4
"""Time steps per frame to which the gain and the firmness of the surface refer."""

SPREAD = 4.0
"""Growth of the volume from which on matter is thin everywhere: what a node may hold and still
count goes down with it."""

TENSION = 1.0
"""Surface tension where none is asked for and parts are not carried [dx]."""

SETTLING_BEGINS = 0.985
"""Share of the change from which particles spread more evenly."""

REBUILD_EVERY = 10
"""Frames after which the index of nearest neighbours is built anew: particles that are neighbours
stay so for longer."""

BAND = 1.5
"""Distances to a surface are exact so far from it, or a little less [cells]."""


MARGIN = 5
"""The grid extends so far beyond the shapes [cells]."""

EXTENTS = 4
"""Half the cells along an axis are a multiple of this, so that few grids serve all shapes."""


class FlowOptions(MpmOptions):
    """Matter flows inside a body that changes from source to target, driven by pressure.

    The body, the flow and what moves matter beside it: docs/method.md.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "stiff": {"memory": 10.0, "tension": 0.0},
        "soft": {"material": {"youngs_modulus": 15000.0}, "tension": 0.5, "momentum": 0.5},
        "viscous": {"memory": 0.2, "tension": 1.0},
        "fluid": {"material": {"youngs_modulus": 1.0}, "memory": 0.0, "tension": 2.0},
    }
    cost: ClassVar[CostRates] = CostRates(4.2e-6, 0.9e-6, 1.46, 0.2, 0.005, bytes_per_node=230)
    fixed: ClassVar[tuple[str, ...]] = ("frames", "rest", "like_parts", "landmarks")

    name: Literal["flow"] = "flow"
    kernel: Kernel = Field("quadratic", description="B-spline interpolation.")
    watchdog: RestartingWatchdogConfig = RestartingWatchdogConfig()
    cell: Positive = Field(1.5, description="Edge of a grid cell of the flow [h].")
    steps_per_frame: int = Field(
        4, ge=1, le=200, description="Minimum number of time steps per frame."
    )
    like_parts: Literal["auto", "on", "off"] = Field(
        "auto",
        description="Carry parts of the source to similar parts of the target; auto: if the source "
        "carried this way matches the target.",
    )
    landmarks: tuple[Landmark, ...] = Field(
        (),
        max_length=64,
        description="Points of the source that are to end at points of the target.",
    )
    gain: Fraction = Field(
        0.3, description="Share of a density error that is corrected in a quarter of a frame."
    )
    reach: Positive = Field(
        4.0,
        description="Distances outside are compressed beyond this, so that limbs grow gradually "
        "[dx].",
    )
    tension: NonNegative | None = Field(
        None,
        description="Surface tension: how much the body is rounded half-way [dx]; None: 0, or 1 if "
        "parts are not carried.",
    )
    depth: float = Field(0.35, description="Particles stay this far inside the surface [h].")
    momentum: Fraction = Field(0.0, description="Share of velocity that remains after a frame.")
    material: MaterialConfig = MaterialConfig()
    memory: NonNegative = Field(
        5.0, description="Frames after which 63 % of the strain has relaxed."
    )
    separation: Fraction = Field(
        0.85, description="Particles closer than this are moved apart on the way [h]; 0: never."
    )
    final_separation: Fraction = Field(0.92, description="The same when the shape comes to rest.")
    settling: Fraction = Field(
        0.02,
        description="Largest total movement of particles by settling, relative to the mean path.",
    )
    rounds: int = Field(4, ge=0, le=40, description="Rounds of settling per frame.")
    rest: float = Field(
        0.1,
        ge=0,
        lt=1,
        description="Share of the frames, at the end, during which the shape rests.",
    )

    def node_count(self, config: MethodConfig, *, radius: float, ratio: float) -> int:
        """Nodes of the grid of the flow."""
        edge, extent = grid_size(self, config, radius=radius, ratio=ratio)
        return nodes_per_axis(extent * edge, edge) ** 3

    def share_of_change(self, frame: float, frames: int) -> float:
        """Begins and ends at rest."""
        return smoothstep(frame / ((1 - self.rest) * frames))

    def check_grid(self, grid: GridConfig) -> None:
        """Refuse drag beyond the longest time step; waves are as slow as any step asks."""
        self.check_drag(self.time.dt * self.time.transitions_per_frame / self.steps_per_frame)

    def check_legs(self, count: int) -> None:
        """Refuse landmarks, which belong to one source and one target."""
        if self.landmarks:
            raise ConfigError(
                f"Landmarks need exactly one target, and there are {count}.",
                "Omit them, or make one morph for each pair of shapes.",
            )


class Flow(MpmMethod[FlowOptions]):
    """A body goes from source to target; matter fills it evenly and flows inside.

    Every time step the pressure of the projection moves mass to where the body will hold it, by
    the smallest change of velocities that does. Elastic strain and momentum decide the rest.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        config, options, device = problem.config, self.options, self.device
        edge, extent = grid_size(
            options,
            config,
            radius=geometry.outer_radius(problem.source, problem.target),
            ratio=len(problem.target) / len(problem.source),
        )
        self._grid = mpm.Grid(edge, extent * edge, width=4 if options.kernel == "cubic" else 3)
        self._simulation = self._make_simulation_in_cells()
        self._edge = edge
        full = options.material.density * edge**3
        cells, spacing = self._simulation.grid, config.spacing / edge
        self._projection = flow.Projection(cells, full=full)
        self._settling = flow.Settling(len(problem.source), cells, spacing)
        self._stray_pieces = flow.StrayPieces(
            [problem.source / edge, problem.target / edge], spacing, self._settling.cells
        )
        axis = flow.fine_axis(self._grid)
        with span("matching"):
            self._like_parts = LikeParts(problem, options.like_parts, options.landmarks)
        self._path = flow.BodyPath(
            self._distance(problem.source_mesh, problem.source, axis),
            self._distance(problem.target_mesh, problem.target, axis),
            self._grid,
            reach=options.reach,
            matter=len(problem.source) * self._mass / full,
            tension=self._tension,
            warp=self._like_parts.warp,
        )
        self._bodies = flow.BodiesAhead(self._path)
        self._nearest_gap = flow.NearestGap(self._settling.cells)
        self._layers = [flow.layer_arrays(layer) for layer in self._simulation.layers]
        self._positions = device.vectors(len(problem.source))
        self._guidance = device.vectors(len(problem.source))
        self._volume_ratio = device.scalars(len(problem.source))
        self._states = flow.BodyStates(self._path, self._grid)
        self._moved = device.scalars(len(problem.source))
        self._body_frame = -1
        time = options.time
        self._frame_seconds = time.dt * time.transitions_per_frame
        self._speed = 0.0
        self._path_length = 0.0
        self._settled = 0.0
        self._residual = 0.0

    def advance(self, frame: int) -> FrameOutcome:
        """Let the body change and matter flow for one frame.

        Raises:
            SimulationError: A particle is lost, even at the smallest time step.
        """
        share, next_share = self._share(frame), self._share(frame + 1)
        self._load_bodies(frame)
        steps = self._steps()
        events = [] if frame else self._like_parts.decisions()
        order = self._cell_order()
        if self._like_parts.warp:
            step = self._like_parts.step(self._particles.x, share, next_share)
            velocity = step / (self._frame_seconds * self._edge)  # [cells/s]
            self._guidance.from_numpy(velocity.astype(self.device.numpy_real)[order])
        for restart in range(self.options.watchdog.restarts + 1):
            faults = self._flow(order, steps, share, next_share)
            if not faults:
                break
            names = ", ".join(mpm.fault_names(faults))
            if restart == self.options.watchdog.restarts:
                raise SimulationError.after(frame, names, "try more `frames`, or `steps_per_frame`")
            steps *= 2
            events.append(restarted(frame, self._frame_seconds / steps, names))
        before, place = self._particles.x, mpm.inverse_order(order)
        last = self._simulation.layers[0]
        self._particles = last.download(place).scaled(self._edge)
        self._particles.F *= np.cbrt(self._volume_ratio.to_numpy())[place, None, None]
        self._match(frame)
        self._path_length += float(geometry.lengths(self._particles.x - before).mean())
        moved = self._moved_by_now() * self._edge
        self._settled += moved
        self._speed = float(geometry.lengths(self._particles.v).max())
        numbers = {
            "correction": moved,
            "dt": self._simulation.dt,
            "pressure_residual": self._residual,
        }
        gap = self._nearest_gap.find(last.x, self.problem.config.spacing / self._edge)
        outcome = self._outcome(np.arange(len(order)), numbers, tuple(events))
        return replace(outcome, gap=gap.to_numpy()[place] * self._edge)

    def state(self) -> dict[str, NDArray[Any]]:
        """The particles, their largest speed [dx/s], mean path and what settling made of it."""
        motion = np.array([self._speed, self._path_length, self._settled])
        return super().state() | {"motion": motion}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned."""
        super().restore(state)
        self._speed, self._path_length, self._settled = state["motion"].tolist()

    def _make_simulation_in_cells(self) -> Simulation:
        """The simulation, in which lengths are counted in cells of the grid.

        Kernels are compiled for a grid: so those of one pair of shapes serve most others.
        """
        options, config, grid = self.options, self.problem.config, self._grid
        cells = mpm.Grid(1.0, round(grid.half_extent / grid.dx), width=grid.width)
        return mpm.Simulation(
            np.full(len(self.problem.source), config.spacing**3),
            grid=cells,
            material=self._material(options.time.dt),
            dt=options.time.dt,
            transitions=1,
            domain=min(config.domain / grid.dx, cells.half_extent),
            largest_cells_per_step=options.watchdog.cells_per_step,
        )

    def _match(self, frame: int) -> None:
        """Match the particles kept, in the order of the source, with the target points."""
        self._positions.from_numpy(self._particles.x)
        if frame % REBUILD_EVERY == 0:
            self._matches.rebuild(self._positions)
        self._matches.update(self._positions)

    def _share(self, frame: int) -> float:
        return self.options.share_of_change(frame, self.problem.config.frames)

    def _distance(
        self, mesh: Mesh | None, points: NDArray[np.float32], axis: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Signed distance to a mesh, or to the points where there is none."""
        if mesh is None:
            return geometry.cloud_distance(points, axis, self.problem.config.spacing)
        band = BAND * self._grid.dx
        found = kept_results.kept(
            "distance",
            (mesh.vertices, mesh.faces, axis, band),
            lambda: {"distance": geometry.mesh_distance(mesh, axis, band)},
        )
        if not (found["distance"] < 0).any():  # a sheet between the points of the lattice
            return geometry.cloud_distance(points, axis, self.problem.config.spacing)
        return found["distance"]

    @property
    def _tension(self) -> float:
        """How far the body is rounded half-way [dx]: one that is carried keeps its form."""
        if self.options.tension is None:
            return 0.0 if self._like_parts.warp else TENSION
        return self.options.tension

    def _load_bodies(self, frame: int) -> None:
        """Bring the body before and after the frame to the device."""
        if self._body_frame != frame:
            self._states.set_before(self._body(frame))
        else:
            self._states.exchange()
        self._states.set_after(self._body(frame + 1))
        self._body_frame = frame + 1

    def _body(self, frame: int) -> Body:
        return self._bodies.at(*(self._share(frame + later) for later in range(3)))

    def _reach(self, steps: int) -> NodeBox:
        """The nodes that particles may reach in a frame of so many steps."""
        grid, x = self._simulation.grid, self._particles.x
        farthest = steps * self._simulation.largest_cells_per_step  # more is a fault
        reach = math.ceil(farthest) + grid.width
        low, high = (
            np.array([end(x[:, axis]) for axis in range(3)]) / self._edge - grid.origin
            for end in (np.min, np.max)
        )
        return NodeBox(
            np.floor(low).astype(np.int64) - reach, np.ceil(high).astype(np.int64) + reach
        )

    def _steps(self) -> int:
        """Time steps of a frame, from the speed of the last one and of elastic waves."""
        options = self.options
        wave = math.sqrt(options.material.lame_mu / options.material.density)
        cells = self._frame_seconds / self._grid.dx
        of_waves = min(wave * cells / COURANT, WAVE_STEPS)
        of_motion = self._speed * cells / CELLS_PER_STEP
        return max(options.steps_per_frame, math.ceil(max(of_waves, of_motion)))

    def _material(self, dt: float) -> Material:
        """What particles are made of, in cells, with waves as slow as a time step asks for [s]."""
        material = self.options.material
        stiffest = material.density * (COURANT / dt) ** 2
        return mpm.Material(
            model=mpm.MODELS[material.model],
            lame_lambda=0.0,  # pressure is the projection's: shear alone is left
            lame_mu=min(material.lame_mu / self._grid.dx**2, stiffest),
            particle_mass=self._mass,
            drag=material.drag,
        )

    def _flow(self, order: NDArray[np.intp], steps: int, share: float, next_share: float) -> int:
        """Make the time steps of a frame from the state kept; returns fault bits."""
        simulation, options = self._simulation, self.options
        simulation.layers[0].upload(self._particles.scaled(1 / self._edge), order)
        simulation.dt = self._frame_seconds / steps
        simulation.material = self._material(simulation.dt)
        simulation.clear_faults()
        body = self._states.box
        self._projection.look_at(body, body.union(self._reach(steps)))
        self._projection.forget()
        self._residual = 0.0
        self._moved.fill(0)
        self._volume_ratio.fill(1)
        depth = options.depth * self.problem.config.spacing / self._edge
        momentum = options.momentum ** (1 / steps)
        gain = 1 - (1 - options.gain) ** (STEPS / steps)
        thinness = self._thinness(next_share)
        memory = options.memory * (1 - share)
        elasticity = math.exp(-1 / (steps * memory)) if memory > 0.01 else 0.0
        for step in range(steps):
            part = (step + 1) / steps
            flow.prepare(
                self._layers[0], self._volume_ratio, self._guidance, self._states.levels, part,
                depth, min(1.0, 3 * STEPS / steps), momentum, elasticity, simulation.dt,
                simulation.grid,
            )  # fmt: skip
            nodes = simulation.transitions[0].nodes
            self._projection.clear(nodes)
            simulation.to_nodes()
            shares = step / steps, part
            residual = self._projection.project(
                nodes, self._states.masses, shares, simulation.dt, gain, thinness=thinness
            )
            self._residual = max(self._residual, residual)
            simulation.to_particles()
            left, left_then = (
                options.rounds - i * options.rounds // steps for i in (step, step + 1)
            )
            now = share + part * (next_share - share)
            for rounds in range(left, left_then, -1):
                self._settle(simulation.layers[1].x, now, (self._states.levels, part), rounds)
            simulation.layers.reverse()
            self._layers.reverse()
            if simulation.faults:
                return simulation.faults
        self._stray_pieces.gather(simulation.layers[0].x, self._moved, self._spacing(next_share))
        return 0

    def _thinness(self, share: float) -> float:
        """How much less than usual a node may hold and still count, at a share of the change."""
        source, target = self._path.volumes
        growth = (1 - share) + share * target / source
        return min(1.0, SPREAD / growth)

    def _settle(self, x: Any, share: float, body: tuple[Any, float], rounds: int) -> None:
        """Spread particles more evenly than the grid can, by at most their part of the path.

        What may be moved in a frame goes in equal parts to the rounds that are left in it.
        """
        options = self.options
        apart = np.interp(
            share, (SETTLING_BEGINS, 1), (options.separation, options.final_separation)
        )
        spacing = self._spacing(share)
        allowed = (options.settling * self._path_length - self._settled) / self._edge
        most = (allowed - self._moved_by_now()) / rounds
        if most > 0:
            self._settling.settle(
                x, self._moved, body, distance=float(apart) * spacing, spacing=spacing, most=most
            )

    def _spacing(self, share: float) -> float:
        """Lattice spacing of the particles at a share of the change [cells]."""
        first, last = self._path.volumes
        growth = float(np.cbrt(1 - share + share * last / first))
        return growth * self.problem.config.spacing / self._edge

    def _moved_by_now(self) -> float:
        """What particles were moved in this frame beside the flow, on average [cells]."""
        return float(self._moved.to_numpy().mean(dtype=np.float64))


def grid_size(
    options: FlowOptions, config: MethodConfig, *, radius: float, ratio: float
) -> tuple[float, int]:
    """Edge of a cell of the grid of the flow [dx], and half its cells along an axis.

    Cells are larger where particles end, or begin, farther apart. The grid holds a ball around the
    shapes, in which they may turn, or the domain.

    Args:
        options: Of the method.
        config: The configuration they are in.
        radius: Of the ball around the origin that holds both shapes [dx].
        ratio: Target points over particles.
    """
    growth = ratio ** (1 / 3)
    edge = options.cell * config.spacing * max(growth, math.sqrt(growth))
    wanted = min(radius / edge + MARGIN, config.grid.half_extent / edge)
    return edge, math.ceil(wanted / EXTENTS) * EXTENTS
