"""A job as the API shows it."""

from __future__ import annotations

from server.keyring import Caller
from server.problems import ProblemError, not_found
from server.schemas import Job, Progress
from server.service import Service
from worker.job import JobState
from worker.progress import read_progress
from worker.queue import JobRecord
from worker.state import Action, allowed

ID_LENGTH = 26


def find(job_id: str, caller: Caller, service: Service) -> JobRecord:
    """A job that the caller may see.

    Raises:
        ProblemError: 404.
    """
    record = service.queue.get(job_id) if is_id(job_id) else None
    if record is None or not caller.sees(record.owner):
        raise not_found("job", job_id)
    return record


def is_id(text: str) -> bool:
    """Whether a text may be the id of a job or a sweep."""
    return len(text) == ID_LENGTH and text.isascii() and text.isalnum()


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


def show(record: JobRecord, service: Service, *, alone: bool = True) -> Job:
    """A job as the API shows it.

    Args:
        record: As the queue knows it.
        service: Where to look for its progress.
        alone: Whether to count the jobs before it too, which takes a query.
    """
    config = record.spec.config
    position = None
    if alone and record.state is JobState.QUEUED:
        position = service.queue.position(record.id)
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
        progress=progress(record, service, position),
        queue_position=position,
        outcome=record.outcome,
        problem=record.problem,
    )


def progress(record: JobRecord, service: Service, position: int | None = None) -> Progress:
    """How far a job has come.

    While it waits, the time left is its own estimate and as much for each job before it, shared
    out over the slots of this machine.
    """
    seen = read_progress(service.storage, record.id, record.spec)
    left = None if record.state.finished else seen.seconds_left
    estimated = float(record.attributes.get("estimate", 0))
    if record.state is JobState.QUEUED:
        left = left if left is not None else estimated
        left += estimated * (position or 0) / max(service.settings.workers, 1)
    elif record.state is JobState.RUNNING and left is None:
        left = estimated
    return Progress(
        frame=seen.frame,
        frames=seen.frames,
        attempt=seen.attempt,
        metrics=seen.metrics,
        seconds_left=left,
    )
