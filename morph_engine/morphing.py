"""A morph from beginning to end: shapes to particles, frame after frame, to a result file.

For example::

    for frame in morph("sphere", "star"):
        print(frame.index, frame.metrics["two_sided"])
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
import psutil
from numpy.typing import NDArray

from morph_engine import backend, kept_results, methods
from morph_engine.config import MorphConfig
from morph_engine.cost import BYTES_IN_RESULT, estimate_run
from morph_engine.device import Device
from morph_engine.errors import (
    ConfigError,
    DiskSpaceError,
    MeshError,
    MorphError,
    ResourceError,
    ResultError,
    SimulationError,
)
from morph_engine.geometry.mesh import Mesh, checked_mesh, shape_of_trimesh
from morph_engine.geometry.placement import placed
from morph_engine.geometry.point_cloud import lengths
from morph_engine.geometry.sampling import (
    MINIMUM_PARTICLES,
    Jitter,
    Similarity,
    sample_lattice,
)
from morph_engine.geometry.shapes import resolve_shape
from morph_engine.ingest import check_mesh
from morph_engine.machine_cores import usable_cores
from morph_engine.machine_memory import free_memory
from morph_engine.memory_return import return_free_memory
from morph_engine.methods import FrameOutcome, Method, Problem
from morph_engine.methods.outcome_check import check_outcome
from morph_engine.metrics.chamfer import chamfer_metrics
from morph_engine.metrics.deformation import determinant_metrics, determinants
from morph_engine.metrics.volume import fill_metrics, outside_metrics
from morph_engine.optimization.watchdog import Event
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord, Shape, config_at, growths, placement_of
from morph_engine.results.spool import Checkpoint, Spool, finished_frames
from morph_engine.results.trajectory import write_result
from morph_engine.spans import span

if TYPE_CHECKING:
    import trimesh

ShapeLike: TypeAlias = (
    "Mesh | npt.ArrayLike | str | Path | trimesh.Trimesh | trimesh.Scene | trimesh.PointCloud"
)
"""A mesh, points of shape [n, 3] in grid units, a file, or the name of a built-in shape."""

Targets: TypeAlias = "ShapeLike | Sequence[ShapeLike]"
"""A target, or several in a list or tuple, which the morph goes through one after the other."""

Stage = Literal["preparing", "computing"]
"""What goes on before the first frame of a leg: the method gets ready, the frame is computed."""

MEGABYTE = 1e6


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a morph.

    Attributes:
        index: 0-based frame index.
        positions: Particle positions [dx], shape [n, 3], float32, in the order of the source.
        metrics: Metrics by name, see `metrics.METRICS`.
        events: What the watchdog did in this frame.
        seconds: Wall-clock time of the frame [s].
        cpu_seconds: CPU time of the frame, summed over threads [s].
        det_f: det F of each particle [ratio], shape [n], float32; None for methods without it.
        leg: Index of the target that it leads to, of a morph through several.
    """

    index: int
    positions: NDArray[np.float32]
    metrics: dict[str, float]
    events: tuple[Event, ...]
    seconds: float
    cpu_seconds: float
    det_f: NDArray[np.float32] | None = None
    leg: int = 0


@span("filling")
def prepare(source: ShapeLike, target: Targets, config: MorphConfig | None = None) -> RunRecord:
    """Turn shapes into particles and target points, in the domain of the configuration.

    Of several targets, each is filled at the spacing that the particles have in the shape before.

    Raises:
        ConfigError: There is no target, the method takes but one, or the configuration is none.
        MeshError: A shape is unusable, does not fit the domain, or holds too few particles.
    """
    config = configure() if config is None else config
    if not isinstance(config, MorphConfig):
        raise ConfigError(
            f"The configuration is a {type(config).__name__}, not a MorphConfig.",
            'Make it with configure(...), as in configure("fast", {"frames": 2}).',
        )
    targets: list[Any] = (
        list(target) if isinstance(target, list | tuple) and not _is_cloud(target) else [target]
    )
    if not targets:
        raise ConfigError("There is no target.", "Give one, or several in order.")
    if len(targets) > 1:
        config.method.check_legs(len(targets))
    source_shape = _resolve(source)
    *via, target_shape = [_resolve(shape) for shape in targets]
    placement = placement_of(source_shape, target_shape, config, via)
    source_points = _points(source_shape, placement.source, config)
    points: list[NDArray[np.float32]] = []
    for shape, to_grid in zip((*via, target_shape), placement.stops[1:], strict=True):
        growth = growths(len(source_points), [len(each) for each in points])[-1]
        points.append(_points(shape, to_grid, config_at(config, growth)))
    *via_points, target_points = points
    preset, _, version = config.preset.rpartition("-")
    return RunRecord(
        config=config,
        source=source_shape,
        target=target_shape,
        source_points=source_points,
        target_points=target_points,
        via=tuple(via),
        via_points=tuple(via_points),
        placement=placement,
        preset=preset or config.preset,
        preset_version=int(version) if version.isdigit() else 0,
        seeds={"jitter": config.seed},
    )


def morph(
    source: ShapeLike,
    target: Targets,
    config: MorphConfig | None = None,
    *,
    device: Device = "auto",
    threads: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> Morph:
    """Morph one shape into another, frame by frame, or through several.

    Args:
        source: Where the particles come from: a mesh, also one of trimesh, in any coordinates;
            points of shape [n, 3] in grid units, as an array or nested lists; a file; or the name
            of a built-in shape.
        target: What they are to become; of several targets in a list, one after the other. The path
            to each is a leg of `config.frames` frames, which begins with the particles as the last
            one has ended. A list of rows of three numbers is one target.
        config: All parameters, as `configure` makes them; the default preset when not given.
        device: Where to compute.
        threads: CPU threads, at most 1024; 0 takes every core. Several morphs at once in a process
            have the same device, threads and precision.
        out: Result file (VTKHDF). Every finished frame is safe on disk at once, and the file is
            written when the run ends, whether complete or interrupted.
        resume: Go on with the unfinished run of `out`; the frames already there come first.
        overwrite: Replace an unfinished run of `out`.

    Returns:
        The frames in order, each computed when it is asked for; asking raises `MorphError` on bad
        input, where memory lacks, and for a frame that cannot be completed. A notebook whose cell
        ends with it computes all of them, shows how far it is, and then a viewer.
    """
    options = {"device": device, "threads": threads, "resume": resume, "overwrite": overwrite}
    return Morph(partial(prepare, source, target, config), out, options)


class Morph(Iterator[Frame]):
    """The frames of a morph, see `morph`.

    Args:
        prepare: Makes the record of the run.
        out: The result file.
        options: Further arguments of `run`.
    """

    def __init__(
        self, prepare: Callable[[], RunRecord], out: str | Path | None, options: dict[str, Any]
    ) -> None:
        self._prepare = prepare
        self._out = out
        self._options = options
        # knows nothing of this object, so that both go when nobody has it any more
        self._frames = _prepared_run(prepare, out, options)

    def __next__(self) -> Frame:
        return next(self._frames)

    def close(self) -> None:
        """End the run where it is; with `out` what is finished is kept."""
        self._frames.close()

    def _ipython_display_(self) -> None:
        """What a notebook calls to display this."""
        from morph_engine import notebook

        record = self._prepare()
        notebook.show(
            record,
            lambda out, on_stage: run(record, out=out, on_stage=on_stage, **self._options),
            self._out,
        )


def _prepared_run(
    prepare: Callable[[], RunRecord], out: str | Path | None, options: dict[str, Any]
) -> Generator[Frame, None, None]:
    yield from run(prepare(), out=out, **options)


def run(
    record: RunRecord,
    *,
    device: Device = "auto",
    threads: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    on_stage: Callable[[Stage], None] = lambda stage: None,
) -> Iterator[Frame]:
    """Run, resume or repeat what a run record describes; arguments as for `morph`.

    `on_stage` hears what goes on before the first frame; from the first stage on, the run directory
    of `out` holds the source.
    """
    config = record.config
    if out is not None and not (resume or overwrite) and Path(out).exists():
        raise ResultError(f"{out} already exists.", "Choose another `out`, or set `overwrite`.")
    check_resources(record, out)
    # Everything that can be refused is refused before a run directory exists.
    method = methods.find(config.method.name)
    backend.start(device, threads=threads, precision=config.precision)
    with backend.in_use():
        yield from _run(record, method, threads, on_stage, out, resume, overwrite)


def _run(
    record: RunRecord,
    method: type[Method[Any]],
    threads: int,
    on_stage: Callable[[Stage], None],
    out: str | Path | None,
    resume: bool,
    overwrite: bool,
) -> Iterator[Frame]:
    """What is left to do once Taichi runs."""
    if out is None:
        yield from _frames(record, method, threads, on_stage)
        return
    spool = Spool.open(out, record) if resume else Spool.create(out, record, replace=overwrite)
    with spool:
        complete = False
        try:
            yield from _frames(record, method, threads, on_stage, spool)
            complete = True
        except MorphError:
            if not spool.frame_count:  # it was refused, and there is nothing to go on from
                spool.remove()
            raise
        finally:
            if spool.frame_count:
                return_free_memory()
                with span("writing"):
                    write_result(spool, status="complete" if complete else "partial")
        spool.remove()


def check_resources(record: RunRecord, out: str | Path | None = None) -> None:
    """Refuse a run that this machine cannot hold.

    Raises:
        ResourceError: Not enough memory or disk.
    """
    need = estimate_run(record)
    free = free_memory() / MEGABYTE
    if need.memory_mb > free:
        raise ResourceError(
            f"The run needs about {need.memory_mb:,.0f} MB of memory and {free:,.0f} MB are free.",
            "Lower `sampling.points_per_cell_edge`, or free some memory.",
        )
    if out is None:
        return
    folder = Path(out).absolute().parent
    if not folder.is_dir():
        raise ResourceError(f"There is no folder {folder}.", "Create it, or choose another `out`.")
    # The frames lie on the disk twice while the result is assembled; some may be there already.
    frames = 2 * record.planned_frames - finished_frames(out)
    disk = BYTES_IN_RESULT * record.particle_count * frames / MEGABYTE + 10
    room = psutil.disk_usage(str(folder)).free / MEGABYTE
    if disk > room:
        raise DiskSpaceError(
            f"The result needs {disk:,.0f} MB of disk and {room:,.0f} MB are free in {folder}.",
            "Free some space, or choose another `out` or fewer `frames`.",
        )


def _frames(
    record: RunRecord,
    kind: type[Method[Any]],
    threads: int,
    on_stage: Callable[[Stage], None],
    spool: Spool | None = None,
) -> Iterator[Frame]:
    """The frames of all legs, those first that the spool has."""
    checkpoint = spool.load_checkpoint() if spool else None
    done = checkpoint.frame + 1 if checkpoint else 0
    leg, first, start = 0, 0, record.source_points
    if spool:
        spool.truncate_after(done - 1)
    if spool and done:
        leg, first = spool.leg_of(done - 1), done - 1 - spool.frame_in_leg(done - 1)
        start = spool.positions(first - 1) if first else start
    while leg < record.leg_count:
        part = _Leg(record, leg, first, start)
        for frame in _frames_of_leg(part, kind, threads, on_stage, spool, checkpoint):
            first, start = frame.index + 1, frame.positions
            yield frame
        leg, checkpoint = leg + 1, None


class _Leg:
    """A leg of a run.

    Attributes:
        whole: The run that it belongs to.
        record: What it is made of itself.
        index: Its index.
        first: Number of frames before it.
    """

    def __init__(
        self, whole: RunRecord, index: int, first: int, start: NDArray[np.float32]
    ) -> None:
        self.whole = whole
        self.record = whole.leg(index, start)
        self.index = index
        self.first = first

    def problem(self) -> Problem:
        """What the method gets."""
        record = self.record
        source, source_to_grid = record.fitted("source")
        target, target_to_grid = record.fitted("target")
        return Problem(
            record.source_points,
            record.target_points,
            record.config,
            source_mesh=source,
            target_mesh=target,
            source_to_grid=source_to_grid.matrix,
            target_to_grid=target_to_grid.matrix,
        )

    def advance(self, method: Method[Any], index: int) -> FrameOutcome:
        """The next frame, which has an index in the leg."""
        try:
            outcome = method.advance(index)
            check_outcome(outcome, method, index)
            return outcome
        except SimulationError as error:
            raise SimulationError(self._told(error.cause), error.remedy) from error

    def event(self, event: Event) -> Event:
        """An event of the leg as one of the run."""
        return replace(event, frame=self.first + event.frame, message=self._told(event.message))

    def _told(self, sentence: str) -> str:
        return f"Leg {self.index + 1}: {sentence}" if self.index else sentence


def _frames_of_leg(
    leg: _Leg,
    kind: type[Method[Any]],
    threads: int,
    on_stage: Callable[[Stage], None],
    spool: Spool | None,
    checkpoint: Checkpoint | None,
) -> Iterator[Frame]:
    """The frames of a leg; with a checkpoint, which lies in it, all before that come first."""
    on_stage("preparing")
    with span("preparing", leg=leg.index):
        method = kind(leg.problem())
    return_free_memory()  # preparing takes more for a moment than computing does
    on_stage("computing")
    with span("computing", leg=leg.index):
        stopping = EarlyStopping(leg.record.config)
        begin, before = 0, leg.record.source_points
        if spool and checkpoint:
            method.restore(checkpoint.arrays)
            stopping.restore(checkpoint.scalars)
            yield from _stored_frames(spool)
            begin = checkpoint.frame + 1 - leg.first
            before = spool.positions(checkpoint.frame)
        frames = _computed_frames(leg, method, threads, stopping, begin, before)
        if not spool:
            yield from frames
            return
        states = ((frame, _copied(method.state()), stopping.state()) for frame in frames)
        yield from _written_frames(states, spool)


def _written_frames(
    states: Iterator[tuple[Frame, dict[str, NDArray[Any]], dict[str, Any]]], spool: Spool
) -> Iterator[Frame]:
    """Frames with the states after them, each written while the next one is computed.

    Nobody waits for the first one longer than it takes.
    """

    def write(frame: Frame, arrays: dict[str, NDArray[Any]], scalars: dict[str, Any]) -> Frame:
        documents = [event.document() for event in frame.events]
        spool.append(
            frame.index, frame.positions, frame.metrics, documents, frame.det_f, leg=frame.leg
        )
        spool.save_checkpoint(frame.index, arrays, scalars)
        return frame

    with ThreadPoolExecutor(1, "writing") as writer:
        if state := next(states, None):
            frame = write(*state)
            del state  # so that its arrays go
            yield frame
        written: Future[Frame] | None = None
        try:
            for state in states:
                if written:
                    yield written.result()
                written = writer.submit(write, *state)
                del state  # so that its arrays go when they are written
        except SimulationError:
            if written:
                yield written.result()
            raise
        if written:
            yield written.result()


def _copied(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Arrays that stay as they are while the method goes on."""
    return {
        name: np.array(array) if array.flags.writeable else array for name, array in arrays.items()
    }


def _computed_frames(
    leg: _Leg,
    method: Method[Any],
    threads: int,
    stopping: EarlyStopping,
    begin: int,
    before: NDArray[np.float32],
) -> Iterator[Frame]:
    """The frames of a leg from one on, given the positions before it [dx]."""
    record, config = leg.record, leg.record.config
    for index in range(begin, config.frames):
        if stopping.stopped:
            return
        with span("frame", frame=leg.first + index):
            wall, cpu = time.perf_counter(), time.process_time()
            outcome = leg.advance(method, index)
            metrics = _measure(outcome, record, threads)
            det_f = None
            if outcome.deformation is not None:
                det = determinants(outcome.deformation)
                metrics |= determinant_metrics(det)
                det_f = det.astype(np.float32)
                del det
            observed = stopping.observe(index, metrics["s2t"])
            events = [
                *(_placed(leg.whole) if leg.first + index == 0 else ()),
                *(leg.event(event) for event in (*outcome.events, *observed)),
            ]
            if stopping.stopped or index == config.frames - 1:
                return_free_memory()
                with span("measuring"):
                    metrics |= _measure_fill(outcome, record, threads)
            metrics |= outcome.numbers
            positions = np.array(outcome.positions)  # which the method may go on to change
            metrics["max_move"] = _max_move(before, positions)
            before = positions
            frame = Frame(
                index=leg.first + index,
                positions=positions,
                metrics=metrics,
                events=tuple(events),
                seconds=time.perf_counter() - wall,
                cpu_seconds=time.process_time() - cpu,
                det_f=det_f,
                leg=leg.index,
            )
        del outcome
        yield frame


def _stored_frames(spool: Spool) -> Iterator[Frame]:
    for index in range(spool.frame_count):
        yield Frame(
            index=index,
            positions=spool.positions(index),
            metrics=spool.metrics(index),
            events=tuple(Event(**e) for e in spool.events if e["frame"] == index),
            seconds=0.0,
            cpu_seconds=0.0,
            det_f=spool.det_f(index),
            leg=spool.leg_of(index),
        )


def _placed(record: RunRecord) -> list[Event]:
    """What the fit of the shapes has done."""
    placement = record.placement
    data = placement.model_dump(mode="json", include={"source", "via", "target", "up"})
    return [Event(0, "placement", message, data) for message in placement.messages]


def _max_move(before: NDArray[np.float32], after: NDArray[np.float32]) -> float:
    """The farthest that a particle has moved [dx]; inf if one is lost."""
    moved = lengths(after.astype(np.float64) - before)
    return float(np.where(np.isfinite(moved), moved, np.inf).max())


def _measure(outcome: FrameOutcome, record: RunRecord, threads: int) -> dict[str, float]:
    """Metrics of every frame."""
    config = record.config
    metrics = chamfer_metrics(
        outcome.positions,
        record.target_points,
        spacing=config.spacing,
        tau=config.f1_tau,
        domain_half_extent=config.domain,
        d_fwd=outcome.d_fwd,
        nearest_fwd=outcome.nearest_fwd,
        d_rev=outcome.d_rev,
        gap=outcome.gap,
        workers=_workers(threads),
    )
    return metrics


def _measure_fill(outcome: FrameOutcome, record: RunRecord, threads: int) -> dict[str, float]:
    """The floor-free metrics, which take longer and are for the last frame only."""
    metrics = fill_metrics(
        outcome.positions,
        record.target_points,
        spacing=record.config.spacing,
        workers=_workers(threads),
    )
    if isinstance(record.target, Mesh):
        to_user = record.placement.target.inverse()
        scale = to_user.scale
        outside = outside_metrics(to_user.apply(outcome.positions), record.target)
        metrics |= {
            name: value if name.endswith("share") else value / scale
            for name, value in outside.items()
        }
    return metrics


def _workers(threads: int) -> int:
    return threads or usable_cores()


class EarlyStopping:
    """Stops when s->t has not improved for some frames (algorithm 6.5)."""

    def __init__(self, config: MorphConfig) -> None:
        self._config = config.stopping
        self._best = float("inf")
        self._waited = 0

    @property
    def stopped(self) -> bool:
        """Whether no further frame is wanted."""
        return 0 < self._config.patience <= self._waited

    def observe(self, frame: int, s2t: float) -> list[Event]:
        """Take in a frame's s->t; an event when it ends the run."""
        if s2t < self._best - self._config.tolerance:
            self._best, self._waited = s2t, 0
        elif frame >= self._config.earliest_frame or self._waited + 1 < self._config.patience:
            self._waited += 1
        if not self.stopped:
            return []
        return [
            Event(
                frame,
                "stopped",
                f"Stopped: s2t has not improved for {self._waited} frames.",
                {"best_s2t": self._best},
            )
        ]

    def state(self) -> dict[str, Any]:
        """What a resumed run must know."""
        return {"best": self._best, "waited": self._waited}

    def restore(self, state: dict[str, Any]) -> None:
        """Take up a state that `state` returned."""
        self._best, self._waited = state["best"], state["waited"]


def _is_cloud(shapes: Sequence[Any]) -> bool:
    """Whether a list holds the points of one shape, rather than several shapes."""
    return bool(shapes) and all(
        isinstance(row, list | tuple | np.ndarray)
        and len(row)
        and all(isinstance(x, Real) for x in row)
        for row in shapes
    )


def _resolve(shape: Any) -> Shape:
    if isinstance(shape, (str, Path)):
        return resolve_shape(str(shape))
    if isinstance(shape, Mesh):
        return checked_mesh(shape)
    if not isinstance(shape, list | tuple) and not hasattr(shape, "__array__"):
        return shape_of_trimesh(shape)
    try:
        points = np.asarray(shape)
        return points if points.dtype.kind in "biuf" else np.array(points.tolist(), np.float64)
    except (TypeError, ValueError):
        raise MeshError(
            "A point cloud is no array of numbers.", "Give one row of x, y, z per point."
        ) from None


def _points(shape: Shape, to_grid: Similarity, config: MorphConfig) -> NDArray[np.float32]:
    """Points of a shape in grid units, given the map from the user's coordinates."""
    if not isinstance(shape, Mesh):
        return _cloud(shape, config)
    mesh = placed(shape, to_grid)
    jitter: Jitter = "published" if config.sampling.lattice == "published" else "none"

    def fill() -> kept_results.Arrays:
        check_mesh(mesh, own=shape, half_extent=config.domain)
        return {
            "points": sample_lattice(mesh, spacing=config.spacing, jitter=jitter, seed=config.seed)
        }

    inputs = (mesh.vertices, mesh.faces, config.domain, config.spacing, jitter, config.seed)
    return kept_results.kept("filling", inputs, fill)["points"]


def _cloud(points: NDArray[Any], config: MorphConfig) -> NDArray[np.float32]:
    cloud = np.asarray(points, np.float32)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise MeshError(
            f"A point cloud has shape [n, 3], not {list(cloud.shape)}.", "Give one row per point."
        )
    if not np.isfinite(cloud).all():
        raise MeshError("The point cloud contains non-finite coordinates.", "Remove those points.")
    if len(cloud) < MINIMUM_PARTICLES:
        raise MeshError(
            f"The point cloud has {len(cloud)} points, fewer than {MINIMUM_PARTICLES}.",
            "Sample it more densely.",
        )
    reach = float(np.abs(cloud).max())
    if reach > config.domain:
        raise MeshError(
            f"The point cloud extends to {reach:.4g} grid units, beyond the domain of "
            f"+-{config.domain:g}.",
            "Scale and centre it to fit.",
        )
    return cloud
