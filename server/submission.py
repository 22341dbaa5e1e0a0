"""From what a user asks for to what the queue takes; every fault is found here."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from chamfer_morph.schemas import JobRequest, Shape
from chamfer_morph.schemas.ids import derived_id
from chamfer_morph.schemas.jobs import JobOptions, JobPlacement
from chamfer_morph.server.context import ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.reuse import TAKEOVER_SECONDS, find_equal, run_digest, take_over
from chamfer_morph.server.solids import find_solid
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_listing import DISK_BYTES
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.kept_states import states_bytes
from chamfer_morph.worker.settings import Settings
from morph_engine import presets
from morph_engine.config import MorphConfig
from morph_engine.cost import BYTES_IN_RESULT, Estimate, estimate
from morph_engine.errors import ConfigError, MeshError, ResourceError
from morph_engine.geometry.placement import Placement, place
from morph_engine.geometry.sampling import MINIMUM_PARTICLES, Similarity, size_remedy
from morph_engine.geometry.solid import Solid
from morph_engine.results.run_record import config_at

ROUNDNESS = 1.15
"""Radius of the ball around a shape over its largest coordinate: 1.02 to 1.26 for the paper's."""


@dataclass(frozen=True)
class Submission:
    """A job that may be queued.

    Attributes:
        spec: What to compute.
        attributes: What the service keeps beside it.
        priority: Smaller runs earlier.
        reuse: Whether the result of an equal job will do.
        disk_bytes: Disk that it will fill [bytes].
    """

    spec: JobSpec
    attributes: dict[str, str | int | float]
    priority: int
    reuse: bool
    disk_bytes: int


def prepare(request: JobRequest, caller: Caller, context: ServerContext) -> Submission:
    """Resolve a request.

    Raises:
        MorphError: The configuration or a shape cannot be used.
        ProblemError: 422, a mesh is unknown.
    """
    config = configure(request)
    if request.via:
        config.method.check_legs(len(request.via) + 1)
    asked: dict[tuple[str | int, ...], Shape] = {
        ("source",): request.source,
        **{("via", index): shape for index, shape in enumerate(request.via)},
        ("target",): request.target,
    }
    found = [
        find_solid(shape, caller, context, ("body", *loc, "mesh")) for loc, shape in asked.items()
    ]
    solids, names = [solid for solid, _ in found], [name for _, name in found]
    placement = place(
        solids[0],
        solids[-1],
        via=solids[1:-1],
        fit=config.sampling.fit,
        half_extent=config.domain,
        poses=config.placement,
    )
    counts = [
        _particle_count(*shape, config)
        for shape in zip(names, solids, placement.stops, strict=True)
    ]
    expected = _estimate(counts, solids, placement, config, context.settings)
    check_memory(expected.memory_mb, context.settings)
    limit = context.settings.job_timeout_seconds
    spec = JobSpec(
        source=request.source,
        via=tuple(request.via),
        target=request.target,
        config=config,
        device=request.device,
        timeout_seconds=min(request.timeout_seconds or limit, limit),
        states_every=request.states_every,
    )
    needed = disk_bytes(counts[0], spec)
    return Submission(
        spec=spec,
        attributes={
            "name": request.name,
            "body": request_digest(request),
            "run": run_digest(spec),
            "method": config.method.name,
            "preset": request.preset,
            "source_name": names[0],
            **({"via_names": json.dumps(names[1:-1])} if request.via else {}),
            "target_name": names[-1],
            "placement": _job_placement(placement).model_dump_json(),
            "estimate": expected.seconds,
            DISK_BYTES: needed,
        },
        priority=request.priority,
        reuse=request.reuse,
        disk_bytes=needed,
    )


def disk_bytes(particle_count: int, spec: JobSpec) -> int:
    """About the disk that the frames and states of a job fill [bytes]."""
    config, frames = spec.config, spec.frame_count
    states = states_bytes(particle_count, frames, spec.states_every, config.precision)
    return BYTES_IN_RESULT * particle_count * frames + states


def _estimate(
    counts: Sequence[int],
    solids: Sequence[Solid],
    placement: Placement,
    config: MorphConfig,
    settings: Settings,
) -> Estimate:
    """What a job will cost, whose shapes are these in their order, with so many particles."""
    radii = [_radius(*shape) for shape in zip(solids, placement.stops, strict=True)]
    ratios = [after / before for before, after in pairwise(counts)]
    nodes = [
        config.method.node_count(
            config_at(config, (counts[leg] / counts[0]) ** (1 / 3)),
            radius=max(radii[leg : leg + 2]),
            ratio=ratio,
        )
        for leg, ratio in enumerate(ratios)
    ]
    return estimate(
        counts[0],
        round(counts[0] * max(ratios)),
        config.frames * len(ratios),
        method=config.method.name,
        threads=settings.threads or None,
        nodes=max(nodes),
    )


def _job_placement(placement: Placement) -> JobPlacement:
    source, target = (end.matrix.tolist() for end in (placement.source, placement.target))
    return JobPlacement(up=placement.up, source=source, target=target)


def _radius(solid: Solid, to_grid: Similarity) -> float:
    """About the radius of the ball around the origin that holds a shape [dx]."""
    return ROUNDNESS * float(np.abs(to_grid.box(solid.bounds)).max())


def check_memory(needed_mb: float, settings: Settings) -> None:
    """Refuse what no worker has room for.

    Raises:
        ResourceError: It needs more than jobs may have.
    """
    largest = settings.memory_per_job / 1e6
    if needed_mb > largest:
        raise ResourceError(
            f"The job needs about {needed_mb:,.0f} MB of memory; the limit is "
            f"{largest:,.0f} MB per job.",
            "Lower `sampling.points_per_cell_edge`, or raise `grid.dx`.",
        )


def configure(request: JobRequest) -> MorphConfig:
    """The configuration that a request asks for.

    Raises:
        ConfigError: Unknown preset, setting or method, or a value out of range.
    """
    short = {
        name: getattr(request, name)
        for name in ("method", "frames", "seed")
        if getattr(request, name) is not None
    }
    twice = short.keys() & request.overrides.keys()
    if twice:
        name = min(twice)
        raise ConfigError(f"{name} is given twice.", f"Omit it from the overrides, or omit {name}.")
    if "preset" in request.overrides:
        raise ConfigError("The preset is not an override.", "Name it in the field `preset`.")
    config = presets.configure(request.preset, {**request.overrides, **short})
    try:
        json.dumps(config.model_dump(mode="json"), allow_nan=False)
    except ValueError:
        raise ConfigError("A setting is not a finite number.", "Give finite numbers.") from None
    return config


def submit(
    submission: Submission,
    *,
    job_id: str,
    caller: Caller,
    context: ServerContext,
    sweep: str | None = None,
) -> tuple[JobRecord, bool]:
    """Queue a job, once.

    Returns:
        The job, and whether it is new.

    Raises:
        ProblemError: 409, a mesh has been deleted since it was prepared; 422, the id belongs to
            another request.
    """
    equal = None
    if submission.reuse and not submission.spec.states_every:  # an equal job may have kept none
        equal = find_equal(submission.spec, caller.name, context.queue, context.storage)
    with context.mesh_locks.holding(submission.spec.meshes):
        check_meshes(submission.spec, context)
        new = context.queue.enqueue(
            submission.spec,
            job_id=job_id,
            owner=caller.name,
            priority=submission.priority,
            attributes=submission.attributes | ({"sweep": sweep} if sweep else {}),
            delay_seconds=TAKEOVER_SECONDS if equal else None,
        )
    if new and equal:
        take_over(equal, job_id, context.queue, context.storage)
    record = context.queue.get(job_id)
    if record is None:
        raise ProblemError(409, "The job has been deleted in the meantime.", "Submit it again.")
    if not new and record.attributes.get("body") != submission.attributes["body"]:
        raise idempotency_conflict()
    return record, new


def check_meshes(spec: JobSpec, context: ServerContext) -> None:
    """Refuse what uses a mesh that nobody has any more; the locks of its meshes are held.

    Raises:
        ProblemError: 409.
    """
    for mesh in spec.meshes:
        if context.meshes.get(None, mesh) is None or context.storage.mesh_file(mesh) is None:
            raise ProblemError(409, f"The mesh {mesh} has been deleted.", "Upload it again first.")


def idempotent_id(kind: str, caller: Caller, key: str) -> str:
    """The id that an idempotency key of a caller stands for."""
    return derived_id(f"{kind}\0{caller.name}\0{key}")


def request_digest(request: JobOptions) -> str:
    """What tells two requests apart, the same by every version of the service."""
    exclude = {"reuse"} | (set() if request.states_every else {"states_every"})
    return body_digest(request.model_dump(mode="json", exclude=exclude))


def body_digest(body: Mapping[str, Any]) -> str:
    """What tells two requests apart."""
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def idempotency_conflict() -> ProblemError:
    """The same idempotency key came with another request."""
    return ProblemError(
        422,
        "This Idempotency-Key has already been used for another request.",
        "Use a new key for each new request.",
    )


def _particle_count(name: str, solid: Solid, to_grid: Similarity, config: MorphConfig) -> int:
    """About how many particles a shape takes.

    Raises:
        MeshError: It reaches beyond the domain, or has room for too few.
    """
    reach = float(np.abs(to_grid.box(solid.bounds)).max())
    if reach > config.domain:
        raise MeshError(
            f"{name} reaches {reach:.4g} grid units from the centre, beyond the domain, "
            f"which ends at {config.domain:g}.",
            size_remedy(name),
        )
    volume = solid.volume * to_grid.scale**3
    count = round(volume / config.spacing**3)
    if count < MINIMUM_PARTICLES:
        raise MeshError(
            f"{name} has room for only about {count} particles, fewer than {MINIMUM_PARTICLES}.",
            f"Raise `sampling.points_per_cell_edge`, or lower `grid.dx`. {size_remedy(name)}",
        )
    return count
