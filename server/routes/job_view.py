"""A job as the API shows it."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from chamfer_morph.schemas import Job, JobState, Progress
from chamfer_morph.server.context import ServerContext
from chamfer_morph.worker.job_listing import RECORD_CACHE_SIZE
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.progress import JobProgress, read_progress
from morph_engine.files import morph_stem


def file_stem(record: JobRecord) -> str:
    """What to call files of a job, as `morph run` would: sphere-to-bunny."""
    names = [
        str(record.attributes.get("source_name", "source")),
        *record.via_names,
        str(record.attributes.get("target_name", "target")),
    ]
    return morph_stem(names, partial=record.state is not JobState.SUCCEEDED)


class _JobSnapshot(NamedTuple):
    """All that decides how a job is shown; equal as long as nothing has changed."""

    record: JobRecord
    progress: JobProgress
    position: int | None
    slots: int


def to_job(record: JobRecord, context: ServerContext) -> Job:
    """A job as the API shows it."""
    return _to_job(_snapshot(record, context))


def to_json(record: JobRecord, context: ServerContext, *, alone: bool = True) -> bytes:
    """The same in JSON; where it is shown alone, a query counts the jobs before it, too."""
    return _encoded(_snapshot(record, context, alone=alone))


def _snapshot(record: JobRecord, context: ServerContext, *, alone: bool = True) -> _JobSnapshot:
    position = None
    if alone and record.state is JobState.QUEUED:
        position = context.queue.position(record.id)
    progress = read_progress(context.storage, record.id, record.spec)
    return _JobSnapshot(record, progress, position, context.settings.workers)


@lru_cache(maxsize=RECORD_CACHE_SIZE)
def _encoded(snapshot: _JobSnapshot) -> bytes:
    """A job as it stands, encoded once for all who ask before it changes."""
    return _to_job(snapshot).model_dump_json().encode()


def _to_job(snapshot: _JobSnapshot) -> Job:
    record, progress = snapshot.record, snapshot.progress
    config = record.spec.config
    return Job(
        id=record.id,
        name=record.name,
        state=record.state,
        source=record.spec.source,
        via=list(record.spec.via),
        target=record.spec.target,
        source_name=str(record.attributes.get("source_name", "")),
        via_names=record.via_names,
        target_name=str(record.attributes.get("target_name", "")),
        placement=record.placement,
        method=config.method.name,
        preset=str(record.attributes.get("preset", config.preset)),
        seed=config.seed,
        device=record.spec.device,
        priority=record.priority,
        sweep=record.sweep,
        owner=record.owner,
        created_at=record.created_at,
        started_at=record.started_at,
        finished_at=record.finished_at,
        progress=Progress(
            frame=progress.frame,
            frames=progress.frames,
            attempt=progress.attempt,
            metrics=progress.metrics,
            seconds_left=_seconds_left(snapshot),
            stage=progress.stage if record.state is JobState.RUNNING else None,
        ),
        queue_position=snapshot.position,
        forked_from=record.spec.fork,
        reused_from=_reused_from(record),
        paused=record.paused,
        outcome=record.outcome,
        problem=record.problem,
    )


def _reused_from(record: JobRecord) -> str | None:
    """The job whose result it has; one that a worker has computed since has its own."""
    if record.state is not JobState.SUCCEEDED or record.executor is not None:
        return None
    return record.reused_from


def _seconds_left(snapshot: _JobSnapshot) -> float | None:
    """Estimate of the time left [s].

    While a job waits, this is its own estimate and as much for each job before it, shared out over
    the slots of this machine.
    """
    record = snapshot.record
    if record.state.finished:
        return None
    estimated = record.estimate
    measured = snapshot.progress.seconds_left
    left = estimated if measured is None else measured
    if record.state is JobState.QUEUED:
        left += estimated * (snapshot.position or 0) / max(snapshot.slots, 1)
    return left
