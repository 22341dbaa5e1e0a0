"""A job as the API shows it."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from chamfer_morph.schemas import Job, JobState, Progress
from chamfer_morph.schemas.ids import is_id
from chamfer_morph.server.context import Service
from chamfer_morph.server.database.api_keys import Caller
from chamfer_morph.server.http.problems import ProblemError, not_found
from chamfer_morph.worker.frame_reader import Frame, read_frame, read_record
from chamfer_morph.worker.job_state import Action, allowed
from chamfer_morph.worker.progress import JobProgress, read_progress
from chamfer_morph.worker.queue import RECORDS_KEPT, JobRecord
from chamfer_morph.worker.tasks.partial_result import keep_result
from morph_engine.results.run_record import RunRecord


def find(job_id: str, caller: Caller, service: Service) -> JobRecord:
    """A job that the caller may see.

    Raises:
        ProblemError: 404.
    """
    record = service.queue.get(job_id) if is_id(job_id) else None
    if record is None or not caller.sees(record.owner):
        raise not_found("job", job_id)
    return record


def find_frame(record: JobRecord, index: int, service: Service) -> Frame:
    """A frame of a job; -1 is the last one.

    Raises:
        ProblemError: 404.
        ResultError: It is damaged.
    """
    frame = read_frame(service.storage.result_path(record.id), index, record.state.finished)
    if frame is None:
        yet = "" if record.state.finished else " yet"
        raise ProblemError(
            404,
            f"There is no frame {index}{yet}.",
            "See the job's progress for the number of frames.",
        )
    return frame


def find_inputs(record: JobRecord, service: Service) -> RunRecord:
    """What a job is made of.

    Raises:
        ProblemError: 404, it has not begun.
    """
    inputs = read_record(service.storage.result_path(record.id))
    if inputs is None:
        if record.state.finished:
            raise ProblemError(
                404, "The job never began, and has no particles.", "Retry or resume it."
            )
        raise ProblemError(
            404,
            "The job has not begun, and has no particles yet.",
            "Wait until it runs; /v1/shapes and /v1/meshes show the particles of a shape before.",
        )
    return inputs


def find_result(record: JobRecord, service: Service) -> Path:
    """The result file of a finished job, with all its frames; blocks.

    Raises:
        ProblemError: 409, there is none.
        MorphError: Its engine was killed, and its frames cannot be made a result.
    """
    if record.state.finished:
        keep_result(service.storage, record.id, service.settings)
    path = service.storage.result_path(record.id)
    if not record.state.finished or not path.is_file():
        raise ProblemError(
            409,
            f"The job is {record.state.value.replace('_', ' ')} and has no result.",
            "Resume or retry it; it has finished no frame."
            if record.state.finished
            else "Wait for it to finish; single frames can be fetched while it runs.",
            headers={} if record.state.finished else {"Retry-After": "5"},
        )
    return path


def file_stem(record: JobRecord) -> str:
    """What to call files of a job, as `morph run` would: sphere-to-bunny."""
    ends = [str(record.attributes.get(f"{role}_name", role)) for role in ("source", "target")]
    plain = [re.sub(r"\W+", "-", Path(end).stem, flags=re.ASCII).strip("-") for end in ends]
    partial = "" if record.state is JobState.SUCCEEDED else "-partial"
    return f"{plain[0] or 'shape'}-to-{plain[1] or 'shape'}{partial}"


def check_allowed(record: JobRecord, action: Action) -> None:
    """Refuse what makes no sense in the state of a job.

    Raises:
        ProblemError: 409.
    """
    if allowed(record.state, action):
        return
    remedies = {
        "cancel": "Nothing is left to stop.",
        "resume": "Only a failed, cancelled or timed out job can go on; retry starts afresh.",
        "retry": "Cancel it first.",
        "delete": "Cancel it first.",
    }
    verb = {"cancel": "cancelled", "resume": "resumed", "retry": "retried", "delete": "deleted"}
    raise ProblemError(
        409, f"A {record.state.value} job cannot be {verb[action]}.", remedies[action]
    )


class _Standing(NamedTuple):
    """All that decides how a job is shown; equal as long as nothing has changed."""

    record: JobRecord
    progress: JobProgress
    position: int | None
    slots: int


def show(record: JobRecord, service: Service) -> Job:
    """A job as the API shows it.

    Args:
        record: As the queue knows it.
        service: Where to look for its progress.
    """
    return _shown(_standing(record, service))


def show_json(record: JobRecord, service: Service, *, alone: bool = True) -> bytes:
    """A job as the API shows it, in JSON.

    Args:
        record: As the queue knows it.
        service: Where to look for its progress.
        alone: Whether to count the jobs before it too, which takes a query.
    """
    return _shown_json(_standing(record, service, alone=alone))


def _standing(record: JobRecord, service: Service, *, alone: bool = True) -> _Standing:
    position = None
    if alone and record.state is JobState.QUEUED:
        position = service.queue.position(record.id)
    progress = read_progress(service.storage, record.id, record.spec)
    return _Standing(record, progress, position, service.settings.workers)


@lru_cache(maxsize=RECORDS_KEPT)
def _shown_json(standing: _Standing) -> bytes:
    """A job as it stands, encoded once for all who ask before it changes."""
    return _shown(standing).model_dump_json().encode()


def _shown(standing: _Standing) -> Job:
    record, progress = standing.record, standing.progress
    config = record.spec.config
    return Job(
        id=record.id,
        name=record.name,
        state=record.state,
        source=record.spec.source,
        target=record.spec.target,
        source_name=str(record.attributes.get("source_name", "")),
        target_name=str(record.attributes.get("target_name", "")),
        method=config["method"],
        preset=str(record.attributes.get("preset", config["preset"])),
        seed=config["seed"],
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
            seconds_left=_seconds_left(standing),
        ),
        queue_position=standing.position,
        outcome=record.outcome,
        problem=record.problem,
    )


def _seconds_left(standing: _Standing) -> float | None:
    """Estimate of the time left [s].

    While a job waits, this is its own estimate and as much for each job before it, shared out over
    the slots of this machine.
    """
    record = standing.record
    if record.state.finished:
        return None
    estimated = float(record.attributes.get("estimate", 0))
    measured = standing.progress.seconds_left
    left = estimated if measured is None else measured
    if record.state is JobState.QUEUED:
        left += estimated * (standing.position or 0) / max(standing.slots, 1)
    return left
