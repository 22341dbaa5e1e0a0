"""A job as the queue knows it, made of the row of its DBOS workflow."""

from __future__ import annotations

import json
import logging
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

from dbos import PortableWorkflowError, WorkflowStatus
from pydantic import BaseModel, Field, Json

from chamfer_morph.schemas import JobState, Outcome, Problem
from chamfer_morph.schemas.jobs import JobPlacement
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_state import job_state
from chamfer_morph.worker.own_queue import PAUSED_QUEUE

UNREADABLE = Problem(
    cause="What the job has reported cannot be read.",
    remedy="Resume it: its finished frames are reported again.",
    kind="internal",
)

log: logging.Logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class JobRecord:
    """A job as the queue knows it; the same object as long as its row stays as it is.

    Attributes:
        id: Its id.
        owner: Name of the key that submitted it; empty without keys.
        state: Where it stands.
        spec: What to compute.
        name: The user's name for it.
        sweep: The sweep it belongs to, if any.
        priority: Smaller runs earlier among the owner's jobs.
        paused: Whether it waits until its owner ends a pause.
        estimate: What it was expected to take [s].
        via_names: Names of the shapes between its source and its target.
        placement: Where it puts its shapes; None for one that an older version has queued.
        reused_from: The job whose result it was given, if any.
        attributes: Everything that was attached to it.
        created_at, started_at, finished_at: Times in UTC, None while still to come.
        executor: The worker slot that runs it or ran it last.
        outcome: What it left, once it has succeeded.
        problem: Why it failed or timed out.
    """

    id: str
    owner: str
    state: JobState
    spec: JobSpec
    name: str
    sweep: str | None
    priority: int
    paused: bool
    estimate: float
    via_names: list[str]
    placement: JobPlacement | None
    reused_from: str | None
    attributes: dict[str, Any]
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    executor: str | None
    outcome: Outcome | None
    problem: Problem | None

    @property
    def age_and_id(self) -> tuple[int, str]:
        """Its place in a listing: when it was created [ms since 1970], and its id."""
        return round(self.created_at.timestamp() * 1000), self.id


class _Attributes(BaseModel):
    """What is attached to a job and has to be of a type; whoever reads the row relies on it."""

    owner: str = ""
    name: str = ""
    sweep: str | None = None
    priority: int = 0
    estimate: float = Field(0, allow_inf_nan=False)
    via_names: Json[list[str]] = []
    placement: Json[JobPlacement] | None = None
    reused_from: str | None = None


def record_or_none(status: WorkflowStatus) -> JobRecord | None:
    """A job, or None if its row cannot be read; one such row must not hide the others."""
    try:
        return _record(status)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError):
        log.warning("the row of job %s cannot be read", status.workflow_id, exc_info=True)
        return None


def _record(status: WorkflowStatus) -> JobRecord:
    attributes = status.attributes or {}
    known = _Attributes.model_validate(attributes)
    arguments = (status.input or {"args": ()})["args"]
    deadline, ended = status.workflow_deadline_epoch_ms, status.completed_at
    late = deadline is not None and ended is not None and ended >= deadline
    state = job_state(status.status, late=late)
    spec = JobSpec.model_validate(arguments[0])
    try:
        outcome = Outcome.model_validate(status.output) if state is JobState.SUCCEEDED else None
        problem = _problem(state, status.error, spec)
    except ValueError:  # pydantic's
        state, outcome, problem = JobState.FAILED, None, UNREADABLE
    return JobRecord(
        id=status.workflow_id,
        owner=known.owner,
        state=state,
        spec=spec,
        name=known.name,
        sweep=known.sweep,
        priority=known.priority,
        paused=state is JobState.QUEUED and status.queue_name == PAUSED_QUEUE,
        estimate=known.estimate,
        via_names=known.via_names,
        placement=known.placement,
        reused_from=known.reused_from,
        attributes=attributes,
        created_at=utc_time(status.created_at) or datetime.now(timezone.utc),
        started_at=utc_time(status.dequeued_at),
        finished_at=utc_time(status.completed_at) if state.finished else None,
        executor=status.executor_id if status.dequeued_at else None,
        outcome=outcome,
        problem=problem,
    )


def _problem(state: JobState, error: Exception | None, spec: JobSpec) -> Problem | None:
    if state is JobState.TIMED_OUT:
        return Problem(
            cause=f"The job ran longer than its time limit of {spec.timeout_seconds:g} s.",
            remedy="Resume it; it continues from its last frame.",
            kind="timeout",
        )
    if state is not JobState.FAILED:
        return None
    if isinstance(error, PortableWorkflowError) and isinstance(error.data, dict):
        return Problem.model_validate(error.data)
    cause = str(error) if error else "Its worker died repeatedly."
    return Problem(
        cause=cause, remedy="Retry it; if it fails again, read its log.", kind="internal"
    )


def kind_of(error: str | None) -> str:
    """The kind of the problem in the column `error`, without reading all of the job."""
    with suppress(TypeError, ValueError, LookupError):
        return str(json.loads(error or "")["data"]["kind"])
    return "internal"


def utc_time(milliseconds: int | None) -> datetime | None:
    """A time in milliseconds since 1970, or None."""
    if milliseconds is None:
        return None
    return datetime.fromtimestamp(int(milliseconds) / 1000, timezone.utc)
