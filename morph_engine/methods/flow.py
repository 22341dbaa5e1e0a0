"""One body changes its shape, and incompressible matter flows inside it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import lazy_loader as lazy
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from morph_engine import flow, geometry, kept_results, mpm
from morph_engine.errors import ConfigError, SimulationError
from morph_engine.methods.method import FrameOutcome, Problem
from morph_engine.methods.mpm_method import MpmMethod, MpmOptions
from morph_engine.methods.options import CostRates
from morph_engine.methods.transport import ease
from morph_engine.mpm.grid_size import nodes_per_axis
from morph_engine.optimization.watchdog import Event, restarted
from morph_engine.sections import (
    Fraction,
    Kernel,
    MaterialConfig,
    NonNegative,
    Positive,
    RestartingWatchdogConfig,
    Section,
    Vector,
)

threadpoolctl: Any = lazy.load("threadpoolctl")

if TYPE_CHECKING:
    from morph_engine.geometry.mesh import Mesh
    from morph_engine.methods.options import MethodConfig
    from morph_engine.mpm import Layer, Simulation

COURANT = 0.8
"""What an elastic shear wave travels in a time step, at most [cells]."""

CELLS_PER_STEP = 0.3
"""What the fastest particle shall move in a time step [cells]."""

STEPS = 4
"""Time steps per frame to which the gain and the firmness of the surface refer, and after which
particles settle."""

LARGEST_DISTORTION = 0.15
"""Geodesic distortion below which two shapes are taken to have like parts."""

LANDMARK_REACH = 1.0
"""Landmarks lie at most so far from the matter of their shape, and lead what is so near [dx]."""

RETURN = 0.3
"""Share of its distance from where the warp wants it that a particle is to make in a frame."""

TENSION = 1.0
"""Surface tension where none is asked for and parts are not carried to like parts [dx]."""

SETTLING_BEGINS = 0.985
"""Share of the way from which particles spread more evenly."""

BAND = 1.5
"""Distances to a surface are exact so far from it [cells]."""


MARGIN = 5
"""The grid extends so far beyond the shapes [cells]."""

EXTENTS = 4
"""Half the cells along an axis are a multiple of this, so that few grids serve all shapes."""

ENDS = ("source", "target")
"""Of a correspondence."""


class Landmark(Section):
    """A point of the source and where it belongs, in the coordinates of the two shapes."""

    source: Vector
    target: Vector


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
    cost: ClassVar[CostRates] = CostRates(16e-6, 2e-6, 0.5, 0.2, 0.05, bytes_per_node=800)

    name: Literal["flow"] = "flow"
    kernel: Kernel = Field("quadratic", description="B-spline interpolation.")
    watchdog: RestartingWatchdogConfig = RestartingWatchdogConfig()
    cell: Positive = Field(1.5, description="Edge of a grid cell of the flow [h].")
    steps_per_frame: int = Field(4, ge=1, le=200, description="Time steps per frame, at least.")
    like_parts: Literal["auto", "on", "off"] = Field(
        "auto",
        description="Carry parts of the source to like parts of the target; auto: where the "
        "geodesic distances of the best matching agree.",
    )
    landmarks: tuple[Landmark, ...] = Field(
        (), max_length=64, description="Points of the source that end at points of the target."
    )
    gain: Fraction = Field(
        0.3, description="Share of an error of density that a quarter of a frame mends."
    )
    reach: Positive = Field(
        4.0, description="Distances outside are compressed beyond this, so that limbs grow [dx]."
    )
    tension: NonNegative | None = Field(
        None,
        description="Surface tension: the body is rounded by this half-way [dx]; none: 1, and 0 "
        "where parts are carried to like parts.",
    )
    depth: float = Field(0.35, description="Particles stay this far inside the surface [h].")
    momentum: Fraction = Field(0.0, description="Share of velocity that is left after a frame.")
    material: MaterialConfig = MaterialConfig()
    memory: NonNegative = Field(
        5.0, description="Frames after which matter has forgotten 63 % of its strain."
    )
    separation: Fraction = Field(
        0.85, description="Particles closer than this move apart on the way [h]; 0: never."
    )
    final_separation: Fraction = Field(0.92, description="Likewise when the shape comes to rest.")
    settling: Fraction = Field(
        0.02, description="What settling moves particles in all, at most, over the mean path."
    )
    rounds: int = Field(1, ge=0, le=10, description="Rounds of moving per quarter of a frame.")
    rest: float = Field(
        0.1, ge=0, lt=1, description="Share of the frames at the end in which the shape rests."
    )

    def node_count(self, config: MethodConfig, *, radius: float, ratio: float) -> int:
        """Nodes of the grid of the flow."""
        edge, extent = grid_size(self, config, radius=radius, ratio=ratio)
        return nodes_per_axis(extent * edge, edge) ** 3


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
        self._correspondence = self._match()
        found = self._correspondence
        self._warp = flow.Warp(found) if found and self._carries(found) else None
        source = problem.source.astype(np.float64)
        self._followed = self._warp.follow(source) if self._warp else None
        self._held = self._closeness(source)
        self._carried_share = -1.0
        self._path = flow.BodyPath(
            self._distance(problem.source_mesh, problem.source, axis),
            self._distance(problem.target_mesh, problem.target, axis),
            self._grid,
            reach=options.reach,
            matter=len(problem.source) * self._mass / full,
            tension=self._tension,
            warp=self._warp,
        )
        self._bodies = flow.BodiesAhead(self._path)
        self._guidance = device.vectors(len(problem.source))
        self._volume_ratio = device.scalars(len(problem.source))
        self._levels = [device.scalars(len(axis) ** 3) for _ in range(2)]
        self._masses = [device.scalars(self._grid.node_count) for _ in range(2)]
        self._wanted = [device.scalars(self._grid.node_count) for _ in range(2)]
        self._moved = device.scalars(len(problem.source))
        self._body_frame = -1
        time = options.time
        self._frame_seconds = time.dt * time.transitions_per_frame
        self._speed = 0.0
        self._path_length = 0.0
        self._settled = 0.0

    def advance(self, frame: int) -> FrameOutcome:
        """Let the body change and matter flow for one frame.

        Raises:
            SimulationError: A particle is lost, even at the smallest time step.
        """
        share, next_share = self._share(frame), self._share(frame + 1)
        self._load_bodies(frame, share, next_share)
        steps = self._steps()
        events = [] if frame else self._decisions()
        order = self._cell_order()
        if self._warp:
            self._guidance.from_numpy(self._guide(share, next_share)[order])
        for restart in range(self.options.watchdog.restarts + 1):
            faults = self._flow(order, steps, share, next_share)
            if not faults:
                break
            names = ", ".join(mpm.fault_names(faults))
            if restart == self.options.watchdog.restarts:
                raise SimulationError(
                    f"Frame {frame} cannot go on: {names}.",
                    "Those before it are kept; use more frames, or steps_per_frame.",
                )
            steps *= 2
            events.append(restarted(frame, self._frame_seconds / steps, names))
        before = self._particles.x
        self._keep(self._simulation.layers[0], order)
        positions = self.device.upload(self._particles.x[order])
        self._matches.rebuild(positions)
        self._matches.update(positions)
        self._particles.F *= np.cbrt(self._volume_ratio.to_numpy())[np.argsort(order), None, None]
        self._path_length += float(np.linalg.norm(self._particles.x - before, axis=1).mean())
        moved = self._moved_by_now() * self._edge
        self._settled += moved
        self._speed = float(np.linalg.norm(self._particles.v, axis=1).max())
        numbers = {"correction": moved, "dt": self._simulation.dt}
        return self._outcome(order, numbers, tuple(events))

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
        material = options.material
        cells = mpm.Grid(1.0, round(grid.half_extent / grid.dx), width=grid.width)
        return mpm.Simulation(
            np.full(len(self.problem.source), config.spacing**3),
            grid=cells,
            material=mpm.Material(
                model=mpm.MODELS[material.model],
                lame_lambda=0.0,  # pressure is the projection's: shear alone is left
                lame_mu=material.lame_mu / grid.dx**2,
                particle_mass=self._mass,
                drag=material.drag,
            ),
            dt=options.time.dt,
            transitions=1,
            domain=min(config.domain / grid.dx, cells.half_extent),
            largest_cells_per_step=options.watchdog.cells_per_step,
        )

    def _keep(self, layer: Layer, order: NDArray[np.intp]) -> None:
        self._particles = layer.download().scaled(self._edge).permuted(np.argsort(order))

    def _share(self, frame: int) -> float:
        return ease(frame / ((1 - self.options.rest) * self.problem.config.frames))

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
        return found["distance"]

    def _match(self) -> flow.Correspondence | None:
        options, problem = self.options, self.problem
        if options.like_parts == "off" and not options.landmarks:
            return None
        placed = (
            _placed([p.source for p in options.landmarks], problem.source_to_grid, problem.source),
            _placed([p.target for p in options.landmarks], problem.target_to_grid, problem.target),
        )
        found = kept_results.kept(
            "correspondence",
            (problem.source, problem.target, problem.config.spacing, *placed),
            lambda: _arrays(self._match_anew(*placed)),
        )
        return _correspondence(found)

    def _match_anew(
        self, source_marks: NDArray[np.float64], target_marks: NDArray[np.float64]
    ) -> flow.Correspondence:
        """Like parts of the shapes, given where their landmarks are [dx], each shape [k, 3]."""
        source, target = (
            flow.sample_controls(points.astype(np.float64), self.problem.config.spacing, marks)
            for points, marks in (
                (self.problem.source, source_marks),
                (self.problem.target, target_marks),
            )
        )
        with threadpoolctl.threadpool_limits(1, "blas"):  # matrices are small: threads only wait
            return flow.match(source, target)

    def _carries(self, found: flow.Correspondence) -> bool:
        """Whether parts are carried to like parts."""
        wanted = self.options.like_parts == "on" or self.options.landmarks
        return bool(wanted) or found.distortion < LARGEST_DISTORTION

    @property
    def _tension(self) -> float:
        """How far the body is rounded half-way [dx]: shapes with like parts keep theirs."""
        if self.options.tension is None:
            return 0.0 if self._warp else TENSION
        return self.options.tension

    def _decisions(self) -> list[Event]:
        """What was decided before the first frame."""
        found = self._correspondence
        if found is None:
            return []
        message = (
            f"Parts are {'' if self._warp else 'not '}carried to like parts: matched geodesic "
            f"distances differ by {found.distortion:.1%} of their mean."
        )
        data = {"distortion": found.distortion, "plain_distortion": found.plain_distortion}
        return [Event(0, "correspondence", message, data)]

    def _guide(self, share: float, next_share: float) -> NDArray[Any]:
        """Velocity that the warp asks of each particle in a frame [cells/s], shape [n, 3]."""
        here = self._carried if share == self._carried_share else self._carry(share)
        there = self._carry(next_share)
        pull = np.maximum(RETURN * (1 - share), self._held)
        step = there - here + pull[:, None] * (here - self._particles.x)
        return (step / (self._frame_seconds * self._edge)).astype(self.device.numpy_real)

    def _closeness(self, source: NDArray[np.float64]) -> NDArray[np.float64]:
        """How close particles are to a landmark, 1 at it, shape [n]: these follow the warp."""
        if not self._warp or not self.options.landmarks:
            return np.zeros(len(source))
        marks = self._warp.start[: len(self.options.landmarks)]
        distance = np.min([np.linalg.norm(source - mark, axis=1) for mark in marks], axis=0)
        close: NDArray[np.float64] = np.exp(-((distance / LANDMARK_REACH) ** 2))
        return close

    def _carry(self, share: float) -> NDArray[np.float64]:
        """Where the warp wants the particles at a share of the way [dx], shape [n, 3]."""
        assert self._warp and self._followed
        self._carried, self._carried_share = self._warp.forward(self._followed, share), share
        return self._carried

    def _load_bodies(self, frame: int, share: float, next_share: float) -> None:
        """Bring the body before and after the frame to the device."""
        if self._body_frame != frame:
            self._upload_body(0, share, next_share)
        else:
            self._levels.reverse()
            self._masses.reverse()
        self._upload_body(1, next_share, self._share(frame + 2))
        self._body_frame = frame + 1

    def _upload_body(self, slot: int, share: float, following: float) -> None:
        body = self._bodies.at(share, following)
        real = self.device.numpy_real
        self._levels[slot].from_numpy((body.level.ravel() / self._edge).astype(real))
        self._masses[slot].from_numpy(body.mass.ravel().astype(real))

    def _steps(self) -> int:
        """Time steps of a frame, from the speed of the last one and of elastic waves."""
        options = self.options
        wave = math.sqrt(options.material.lame_mu / options.material.density)
        cells = self._frame_seconds / self._grid.dx
        least = max(wave * cells / COURANT, self._speed * cells / CELLS_PER_STEP)
        return max(options.steps_per_frame, math.ceil(least))

    def _flow(self, order: NDArray[np.intp], steps: int, share: float, next_share: float) -> int:
        """Make the time steps of a frame from the state kept; returns fault bits."""
        simulation, options = self._simulation, self.options
        simulation.layers[0].upload(self._particles.permuted(order).scaled(1 / self._edge))
        simulation.dt = self._frame_seconds / steps
        simulation.clear_faults()
        self._projection.forget()
        self._moved.fill(0)
        self._volume_ratio.fill(1)
        depth = options.depth * self.problem.config.spacing / self._edge
        momentum = options.momentum ** (1 / steps)
        gain = 1 - (1 - options.gain) ** (STEPS / steps)
        memory = options.memory * (1 - share)
        elasticity = math.exp(-1 / (steps * memory)) if memory > 0.01 else 0.0
        flow.blend(self._wanted[1], *self._masses, 0.0)
        for step in range(steps):
            part = (step + 1) / steps
            self._wanted.reverse()
            flow.blend(self._wanted[1], *self._masses, part)
            here, there = simulation.layers
            flow.prepare(
                flow.LayerArrays(x=here.x, v=here.v, C=here.C, F=here.F),
                self._volume_ratio, self._guidance, *self._levels, part,
                depth, min(1.0, 3 * STEPS / steps), momentum, elasticity, simulation.dt,
                simulation.grid,
            )  # fmt: skip
            nodes = simulation.transitions[0].nodes
            flow.clear(nodes)
            simulation.to_nodes()
            before, after = self._wanted
            self._projection.project(nodes, before, after, simulation.dt, gain=gain)
            simulation.to_particles()
            quarter = (step + 1) * STEPS // steps
            if quarter > step * STEPS // steps:
                now = share + part * (next_share - share)
                self._settle(there.x, now, (*self._levels, part), STEPS + 1 - quarter)
            simulation.layers.reverse()
            if simulation.faults:
                return simulation.faults
        self._stray_pieces.gather(simulation.layers[0].x, self._moved, self._spacing(next_share))
        return 0

    def _settle(self, x: Any, share: float, body: tuple[Any, Any, float], quarters: int) -> None:
        """Spread particles more evenly than the grid can, by at most their part of the path.

        What may be moved in a frame goes in equal parts to the rounds of the quarters left in it.
        """
        options = self.options
        apart = np.interp(
            share, (SETTLING_BEGINS, 1), (options.separation, options.final_separation)
        )
        spacing = self._spacing(share)
        allowed = (options.settling * self._path_length - self._settled) / self._edge
        for rounds in range(quarters * options.rounds, (quarters - 1) * options.rounds, -1):
            left = (allowed - self._moved_by_now()) / rounds
            if left <= 0:
                break
            self._settling.settle(
                x, self._moved, body, distance=float(apart) * spacing, spacing=spacing, most=left
            )

    def _spacing(self, share: float) -> float:
        """Lattice spacing of the particles at a share of the way [cells]."""
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


def _arrays(found: flow.Correspondence) -> kept_results.Arrays:
    """A correspondence as arrays by name."""
    ends = {
        f"{end}_{name}": value for end in ENDS for name, value in vars(getattr(found, end)).items()
    }
    numbers = {"plan": found.plan, "distortion": found.distortion}
    return {
        name: np.asarray(value)
        for name, value in (ends | numbers | {"plain_distortion": found.plain_distortion}).items()
    }


def _correspondence(arrays: kept_results.Arrays) -> flow.Correspondence:
    """The correspondence of which `_arrays` has made arrays."""
    source, target = (
        flow.Controls(
            points=arrays[f"{end}_points"],
            weights=arrays[f"{end}_weights"],
            geodesic=arrays[f"{end}_geodesic"],
            scale=float(arrays[f"{end}_scale"]),
            landmark_count=int(arrays[f"{end}_landmark_count"]),
        )
        for end in ENDS
    )
    distortions = float(arrays["distortion"]), float(arrays["plain_distortion"])
    return flow.Correspondence(source, target, arrays["plan"], *distortions)


def _placed(
    marks: list[Vector], to_grid: NDArray[np.float64], points: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Landmarks in grid units, shape [k, 3].

    Raises:
        ConfigError: One is not at the shape.
    """
    placed = np.array(marks, np.float64).reshape(-1, 3) @ to_grid[:3, :3].T + to_grid[:3, 3]
    lower, upper = (points.min(axis=0), points.max(axis=0))
    for mark, place in zip(marks, placed, strict=True):
        distance = float(np.linalg.norm(points - place, axis=1).min())
        if distance > LANDMARK_REACH:
            to_user = np.linalg.inv(to_grid)
            corners = np.array([lower, upper]) @ to_user[:3, :3].T + to_user[:3, 3]
            lowest, highest = (", ".join(f"{x:.4g}" for x in corner) for corner in corners)
            raise ConfigError(
                f"The landmark {', '.join(f'{x:g}' for x in mark)} lies {distance:.1f} grid units "
                f"outside the shape, which reaches from ({lowest}) to ({highest}).",
                "Give it in the coordinates of the mesh, on its surface or inside.",
            )
    return placed
