"""A morph from beginning to end: shapes to particles, frame after frame, to a result file.

For example::

    for frame in morph("sphere", "star"):
        print(frame.index, frame.metrics["two_sided"])
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import psutil
from numpy.typing import NDArray

from morph_engine import backend, kept_results, methods
from morph_engine.config import MorphConfig
from morph_engine.cost import estimate
from morph_engine.device import Device
from morph_engine.errors import MeshError, ResourceError
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.placement import placed
from morph_engine.geometry.sampling import (
    MINIMUM_PARTICLES,
    Jitter,
    Similarity,
    sample_lattice,
)
from morph_engine.geometry.shapes import resolve_shape
from morph_engine.ingest import check_mesh
from morph_engine.machine_memory import free_memory
from morph_engine.methods import FrameOutcome, Method, Problem
from morph_engine.metrics.chamfer import chamfer_metrics
from morph_engine.metrics.deformation import deformation_metrics, determinants
from morph_engine.metrics.volume import fill_metrics, outside_metrics
from morph_engine.optimization.watchdog import Event
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord, Shape, placement_of
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import write_result

ShapeLike = Mesh | NDArray[Any] | str | Path
"""A mesh, a point cloud of shape [n, 3] in grid units, a file, or the name of a built-in shape."""

Stage = Literal["preparing", "computing"]
"""What goes on before the first frame: the method gets ready, the first frame is computed."""

MEGABYTE = 1e6
BYTES_PER_PARTICLE = 16
"""Of one frame on the disk: three coordinates and det F."""


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
    """

    index: int
    positions: NDArray[np.float32]
    metrics: dict[str, float]
    events: tuple[Event, ...]
    seconds: float
    cpu_seconds: float
    det_f: NDArray[np.float32] | None = None


def prepare(source: ShapeLike, target: ShapeLike, config: MorphConfig | None = None) -> RunRecord:
    """Turn two shapes into particles and target points, in the domain of the configuration.

    Raises:
        MeshError: A shape is unusable, does not fit the domain, or holds too few particles.
    """
    config = config or configure()
    source_shape, target_shape = _resolve(source), _resolve(target)
    placement = placement_of(source_shape, target_shape, config)
    source_points = _points(source_shape, placement.source, config)
    target_points = _points(target_shape, placement.target, config)
    preset, _, version = config.preset.rpartition("-")
    return RunRecord(
        config=config,
        source=source_shape,
        target=target_shape,
        source_points=source_points,
        target_points=target_points,
        placement=placement,
        preset=preset or config.preset,
        preset_version=int(version) if version.isdigit() else 0,
        seeds={"jitter": config.seed},
    )


def morph(
    source: ShapeLike,
    target: ShapeLike,
    config: MorphConfig | None = None,
    *,
    device: Device = "auto",
    threads: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> Iterator[Frame]:
    """Morph one shape into another, frame by frame.

    Args:
        source: Where the particles come from.
        target: What they are to become.
        config: All parameters; the default preset when not given.
        device: Where to compute.
        threads: CPU threads; 0 takes every core.
        out: Result file (VTKHDF). Every finished frame is safe on disk at once, and the file is
            written when the run ends, whether complete or interrupted.
        resume: Go on with the unfinished run of `out`; the frames already there come first.
        overwrite: Replace an unfinished run of `out`.

    Yields:
        The frames in order.

    Raises:
        MorphError: Bad input, no memory, or a frame that cannot be completed.
    """
    yield from run(
        prepare(source, target, config),
        device=device,
        threads=threads,
        out=out,
        resume=resume,
        overwrite=overwrite,
    )


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
    check_resources(record, out)
    # Everything that can be refused is refused before a run directory exists.
    method = methods.find(config.method.name)
    backend.start(device, threads=threads, precision=config.precision)
    if out is None:
        yield from _frames(record, method, threads, on_stage)
        return
    spool = Spool.open(out, record) if resume else Spool.create(out, record, replace=overwrite)
    with spool:
        complete = False
        try:
            yield from _frames(record, method, threads, on_stage, spool)
            complete = True
        finally:
            if spool.frame_count:
                write_result(spool, status="complete" if complete else "partial")
        spool.remove()


def check_resources(record: RunRecord, out: str | Path | None = None) -> None:
    """Refuse a run that this machine cannot hold.

    Raises:
        ResourceError: Not enough memory or disk.
    """
    config = record.config
    frames = config.frames
    need = estimate(
        len(record.source_points),
        len(record.target_points),
        frames,
        method=config.method.name,
        nodes=config.method.node_count(config, radius=record.radius, ratio=record.ratio),
    )
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
    # The frames lie on the disk twice while the result is assembled.
    disk = 2 * BYTES_PER_PARTICLE * record.particle_count * frames / MEGABYTE + 10
    room = psutil.disk_usage(str(folder)).free / MEGABYTE
    if disk > room:
        raise ResourceError(
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
    config = record.config
    on_stage("preparing")
    source, source_to_grid = record.fitted("source")
    target, target_to_grid = record.fitted("target")
    method = kind(
        Problem(
            record.source_points,
            record.target_points,
            config,
            source_mesh=source,
            target_mesh=target,
            source_to_grid=source_to_grid.matrix,
            target_to_grid=target_to_grid.matrix,
        )
    )
    on_stage("computing")
    stopping = EarlyStopping(config)
    start = 0
    checkpoint = spool.load_checkpoint() if spool else None
    if spool and checkpoint:
        spool.truncate_after(checkpoint.frame)
        start = checkpoint.frame + 1
        method.restore(checkpoint.arrays)
        stopping.restore(checkpoint.scalars)
        for index in range(start):
            events = [Event(**e) for e in spool.events if e["frame"] == index]
            yield Frame(
                index=index,
                positions=spool.positions(index),
                metrics=spool.metrics(index),
                events=tuple(events),
                seconds=0.0,
                cpu_seconds=0.0,
                det_f=spool.det_f(index),
            )
    elif spool:
        spool.truncate_after(-1)
    before = spool.positions(start - 1) if spool and start else record.source_points
    for index in range(start, config.frames):
        if stopping.stopped:
            return
        wall, cpu = time.perf_counter(), time.process_time()
        outcome = method.advance(index)
        metrics = _measure(outcome, record, threads)
        events = [
            *_placed(record, index),
            *outcome.events,
            *stopping.observe(index, metrics["s2t"]),
        ]
        if stopping.stopped or index == config.frames - 1:
            metrics |= _measure_fill(outcome, record, threads)
        metrics |= outcome.numbers
        metrics["max_move"] = _max_move(before, outcome.positions)
        before = outcome.positions
        frame = Frame(
            index=index,
            positions=outcome.positions,
            metrics=metrics,
            events=tuple(events),
            seconds=time.perf_counter() - wall,
            cpu_seconds=time.process_time() - cpu,
            det_f=_det_f(outcome),
        )
        if spool:
            documents = [event.document() for event in events]
            spool.append(index, frame.positions, metrics, documents, frame.det_f)
            spool.save_checkpoint(index, method.state(), stopping.state())
        yield frame


def _placed(record: RunRecord, frame: int) -> list[Event]:
    """What the fit of the shapes has done, told with the first frame."""
    placement = record.placement
    if frame or not placement.message:
        return []
    data = placement.model_dump(mode="json", include={"source", "target"})
    return [Event(0, "placement", placement.message, data)]


def _det_f(outcome: FrameOutcome) -> NDArray[np.float32] | None:
    if outcome.deformation is None:
        return None
    return determinants(outcome.deformation).astype(np.float32)


def _max_move(before: NDArray[np.float32], after: NDArray[np.float32]) -> float:
    """The farthest that a particle has moved [dx]; inf if one is lost."""
    squared = np.sum((after.astype(np.float64) - before) ** 2, axis=1)
    return float(np.sqrt(np.where(np.isfinite(squared), squared, np.inf).max()))


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
        workers=_workers(threads),
    )
    if outcome.deformation is not None:
        metrics |= deformation_metrics(outcome.deformation)
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
    return threads or os.cpu_count() or 1


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
                f"Stopped after frame {frame}: s2t has not improved for {self._waited} frames.",
                {"best_s2t": self._best},
            )
        ]

    def state(self) -> dict[str, Any]:
        """What a resumed run must know."""
        return {"best": self._best, "waited": self._waited}

    def restore(self, state: dict[str, Any]) -> None:
        """Take up a state that `state` returned."""
        self._best, self._waited = state["best"], state["waited"]


def _resolve(shape: ShapeLike) -> Shape:
    if isinstance(shape, (str, Path)):
        return resolve_shape(str(shape))
    return shape


def _points(shape: Shape, to_grid: Similarity, config: MorphConfig) -> NDArray[np.float32]:
    """Points of a shape in grid units, given the map from the user's coordinates."""
    if not isinstance(shape, Mesh):
        return _cloud(shape, config)
    mesh = placed(shape, to_grid)
    jitter: Jitter = "published" if config.sampling.lattice == "published" else "none"

    def fill() -> kept_results.Arrays:
        check_mesh(mesh, half_extent=config.domain)
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
        raise MeshError("The point cloud holds non-finite coordinates.", "Remove those points.")
    if len(cloud) < MINIMUM_PARTICLES:
        raise MeshError(
            f"The point cloud has {len(cloud)} points, fewer than {MINIMUM_PARTICLES}.",
            "Sample it more densely.",
        )
    reach = float(np.abs(cloud).max())
    if reach > config.domain:
        raise MeshError(
            f"The point cloud reaches to {reach:.4g} grid units, beyond the domain of "
            f"+-{config.domain:g}.",
            "Scale and centre it to fit.",
        )
    return cloud
