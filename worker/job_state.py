"""The job state machine: where a job stands, and what may be done with it."""

from __future__ import annotations

from typing import Literal

from chamfer_morph.schemas import JobState

Action = Literal["cancel", "next", "resume", "retry", "delete"]

_BY_STATUS = {
    "DELAYED": JobState.QUEUED,
    "ENQUEUED": JobState.QUEUED,
    "PENDING": JobState.RUNNING,
    "SUCCESS": JobState.SUCCEEDED,
    "ERROR": JobState.FAILED,
    "MAX_RECOVERY_ATTEMPTS_EXCEEDED": JobState.FAILED,
    "CANCELLED": JobState.CANCELLED,
}

STATUSES: tuple[str, ...] = tuple(_BY_STATUS)
"""Every status that a workflow may have."""

_ACTIONS: dict[JobState, frozenset[Action]] = {
    JobState.QUEUED: frozenset({"cancel", "next"}),
    JobState.RUNNING: frozenset({"cancel"}),
    JobState.SUCCEEDED: frozenset({"retry", "delete"}),
    JobState.FAILED: frozenset({"resume", "retry", "delete"}),
    JobState.CANCELLED: frozenset({"resume", "retry", "delete"}),
    JobState.TIMED_OUT: frozenset({"resume", "retry", "delete"}),
}


def job_state(status: str, *, late: bool) -> JobState:
    """The state of a job.

    Args:
        status: Status of its workflow. One that ran out of time is CANCELLED, as is one that a
            user cancelled.
        late: Whether it ended after its deadline, which tells these two apart.
    """
    state = _BY_STATUS[status]
    return JobState.TIMED_OUT if state is JobState.CANCELLED and late else state


def statuses(state: JobState) -> list[str]:
    """The workflow statuses that may stand for a state."""
    wanted = JobState.CANCELLED if state is JobState.TIMED_OUT else state
    return [status for status, of in _BY_STATUS.items() if of is wanted]


def allowed(state: JobState, action: Action) -> bool:
    """Whether an action makes sense in a state."""
    return action in _ACTIONS[state]
