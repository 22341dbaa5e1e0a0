"""The job state machine: statuses to states, and what may be done in each."""

from __future__ import annotations

import pytest
from dbos import WorkflowStatusString

from chamfer_morph.schemas import JobState
from chamfer_morph.worker.job_state import allowed, job_state, statuses

ACTIONS = ("cancel", "next", "resume", "retry", "delete")


@pytest.mark.parametrize(
    ("status", "late", "state"),
    [
        ("DELAYED", False, JobState.QUEUED),
        ("ENQUEUED", False, JobState.QUEUED),
        ("PENDING", False, JobState.RUNNING),
        ("PENDING", True, JobState.RUNNING),
        ("SUCCESS", False, JobState.SUCCEEDED),
        ("SUCCESS", True, JobState.SUCCEEDED),
        ("ERROR", False, JobState.FAILED),
        ("ERROR", True, JobState.FAILED),
        ("MAX_RECOVERY_ATTEMPTS_EXCEEDED", False, JobState.FAILED),
        ("CANCELLED", False, JobState.CANCELLED),
        ("CANCELLED", True, JobState.TIMED_OUT),
    ],
)
def test_state_of_a_status(status, late, state):
    """Every status, in time and late, is one state; and the state is found by the status."""
    assert job_state(status, late=late) is state
    assert status in statuses(state)


def test_every_status_of_the_queue_has_a_state():
    """A status that the queue library knows and we do not would be a crash."""
    for status in WorkflowStatusString:
        assert job_state(status.value, late=False) in JobState


@pytest.mark.parametrize(
    ("state", "actions"),
    [
        (JobState.QUEUED, {"cancel", "next"}),
        (JobState.RUNNING, {"cancel"}),
        (JobState.SUCCEEDED, {"retry", "delete"}),
        (JobState.FAILED, {"resume", "retry", "delete"}),
        (JobState.CANCELLED, {"resume", "retry", "delete"}),
        (JobState.TIMED_OUT, {"resume", "retry", "delete"}),
    ],
)
def test_actions_of_a_state(state, actions):
    """What may be done in a state."""
    assert {action for action in ACTIONS if allowed(state, action)} == actions
    assert state.finished == ("delete" in actions)
