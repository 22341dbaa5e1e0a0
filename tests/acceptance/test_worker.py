"""The walking path of the worker room; `test_faults.py` has all that may go wrong on it."""

from __future__ import annotations

import sys

import pytest

from chamfer_morph.schemas import JobState
from chamfer_morph.worker.slots import executor_id

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")


def test_from_the_queue_to_the_result_on_another_worker(cluster, undisturbed):
    """A worker dies in the middle of a job; another one finishes it, soon and to the last bit."""
    workers = [cluster.worker(slot) for slot in (0, 1)]
    cluster.start("janitor")
    for job in [cluster.submit(frames=1) for _ in range(2)]:  # all are there and warm
        cluster.wait_for_state(job, JobState.SUCCEEDED)
    job = cluster.submit()
    cluster.wait_for_frame(job, 2)
    dead = [executor_id(slot) for slot in (0, 1)].index(cluster.job(job).executor)
    workers[dead].kill()
    before = len(cluster.frames(job))
    cluster.wait_until(lambda: len(cluster.frames(job)) > before + 1, "the job to go on elsewhere")
    cluster.require_sound(job, undisturbed)
    assert cluster.job(job).executor == executor_id(1 - dead)


def test_cancel_and_resume(cluster, undisturbed):
    """Cancelling ends the engine in two seconds and keeps its frames; resuming uses them."""
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 2)
    engine = cluster.engine(worker)
    cluster.queue.cancel(job)
    assert cluster.wait_until(lambda: not engine.is_running(), "the engine to end") < 2
    assert cluster.job(job).state is JobState.CANCELLED
    assert cluster.storage.result_path(job).exists()
    cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed)


def test_a_retry_begins_anew(cluster):
    """What a job left is there until it is in the queue again; then all frames are computed."""
    cluster.worker()
    job = cluster.submit(frames=2)
    first = cluster.wait_for_state(job, JobState.SUCCEEDED)
    cluster.queue.retry(job)
    assert cluster.job(job).state in (JobState.QUEUED, JobState.RUNNING)
    second = cluster.wait_for_state(job, JobState.SUCCEEDED)
    assert second.started_at > first.finished_at
    assert cluster.frames(job) == [0, 1]
    assert cluster.storage.events(job).read()[0].data["attempt"] == 1


def test_the_stages_before_the_first_frame(cluster):
    """They are told in order, and the source is there from the second on."""
    cluster.worker()
    job = cluster.submit(frames=1)
    cluster.wait_for_state(job, JobState.SUCCEEDED)
    events = cluster.storage.events(job).read()
    told = [event.data.get("stage", event.type) for event in events]
    assert told == ["attempt", "filling", "preparing", "computing", "frame"]


def test_own_priorities(cluster):
    """An urgent job takes its owner's first place, and pushes no other owner out of theirs."""
    usual = [cluster.submit(frames=1, owner="a") for _ in range(2)]
    other = cluster.submit(frames=1, owner="b")
    urgent = cluster.submit(frames=1, owner="a", priority=1)
    order = sorted([*usual, other, urgent], key=cluster.queue.position)
    assert order == [other, urgent, *usual]  # both first places are equal; the older job leads
