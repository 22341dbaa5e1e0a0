"""The walking path of the worker room; `test_faults.py` has all that may go wrong on it."""

from __future__ import annotations

import sys
import time

import pytest

from chamfer_morph.schemas import JobState, MeshShape
from chamfer_morph.server.failure_counts import FailureCounts
from chamfer_morph.worker.alarm import SETTLING_PAUSE_SECONDS, SETTLING_SECONDS
from chamfer_morph.worker.slots import executor_id
from tests.acceptance.conftest import POSTGRES_BY_FAULT_TESTS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")

LONG = 10_000
"""Frames of a job that is still running whenever a test looks, on any machine."""


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


@POSTGRES_BY_FAULT_TESTS
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


@POSTGRES_BY_FAULT_TESTS
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


@POSTGRES_BY_FAULT_TESTS
def test_the_stages_before_the_first_frame(cluster):
    """They are told in order, and the source is there from the second on."""
    cluster.worker()
    job = cluster.submit(frames=1)
    cluster.wait_for_state(job, JobState.SUCCEEDED)
    events = cluster.storage.events(job).read()
    told = [event.data.get("stage", event.type) for event in events]
    assert told == ["attempt", "filling", "preparing", "computing", "frame"]


def test_idle_workers_are_told(new_cluster, own_postgres):
    """Of jobs that are submitted, retried or left by the dead; and one takes the next when it ends.

    Without, they would look once in an hour.
    """
    cluster = new_cluster(own_postgres.url, poll_seconds="3600")
    worker = cluster.worker()
    first = cluster.submit(frames=LONG)
    cluster.wait_for_state(first, JobState.RUNNING)
    next_one = cluster.submit(frames=LONG)
    time.sleep(SETTLING_SECONDS + 2 * SETTLING_PAUSE_SECONDS)
    cluster.queue.cancel(first)
    cluster.wait_for_state(next_one, JobState.RUNNING)
    cluster.queue.cancel(next_one)
    time.sleep(2)  # it is idle, and has looked
    again = cluster.submit(frames=LONG)
    cluster.wait_for_state(again, JobState.RUNNING)
    other = cluster.worker(1)
    cluster.wait_for_state(cluster.submit(frames=LONG), JobState.RUNNING)
    time.sleep(SETTLING_SECONDS + 2 * SETTLING_PAUSE_SECONDS)
    assert other.poll() is None
    cluster.start("janitor")
    worker.kill()
    for jobs in cluster.queue.running().values():
        if again not in jobs:
            cluster.queue.cancel(jobs.pop())
    cluster.wait_until(lambda: cluster.job(again).executor == executor_id(1), "its adoption")


@POSTGRES_BY_FAULT_TESTS
def test_failures_are_counted_by_kind(cluster):
    """Each once; one that fails again counts again."""
    cluster.worker()
    late = cluster.submit(timeout=0.001)
    gone = cluster.submit(source=MeshShape(mesh="0" * 64))
    counts = FailureCounts(cluster.queue)
    cluster.wait_for_state(late, JobState.TIMED_OUT)
    cluster.wait_for_state(gone, JobState.FAILED)
    assert counts.since_last_call() == {"timeout": 1, "input": 1}
    assert counts.since_last_call() == {}
    finished = cluster.job(gone).finished_at
    cluster.queue.retry(gone)
    cluster.wait_until(
        lambda: cluster.job(gone).finished_at not in (None, finished), "the job to fail again"
    )
    assert counts.since_last_call() == {"input": 1}
    assert FailureCounts(cluster.queue).since_last_call() == {"timeout": 1, "input": 1}


@POSTGRES_BY_FAULT_TESTS
def test_a_job_that_takes_too_much_memory_is_stopped(cluster):
    """It fails once, with the cause; where it has more memory it goes on from its last frame."""
    tight = cluster.worker(MORPH_JOB_MEMORY_BYTES=str(150_000_000))
    job = cluster.submit()
    problem = cluster.wait_for_state(job, JobState.FAILED).problem
    assert problem.kind == "resources"
    assert "jobs may have 150 MB" in problem.cause
    assert tight.poll() is None
    assert not cluster.engines(tight)
    tight.terminate()
    tight.wait(10)
    cluster.worker()
    cluster.queue.resume(job)
    cluster.wait_for_state(job, JobState.SUCCEEDED)


def test_a_paused_owner_waits(cluster):
    """Others go on meanwhile, and so does what runs; then the owner's own order holds."""
    cluster.worker()
    running = cluster.submit(owner="a", frames=5)
    waiting = [cluster.submit(owner="a", frames=1) for _ in range(2)]
    cluster.wait_for_state(running, JobState.RUNNING)
    cluster.queue.pause("a")
    cluster.queue.put_first(waiting[1])
    other = cluster.submit(owner="b", frames=1)
    cluster.wait_for_state(running, JobState.SUCCEEDED)
    cluster.wait_for_state(other, JobState.SUCCEEDED)
    assert {cluster.job(job).state for job in waiting} == {JobState.QUEUED}
    cluster.queue.unpause("a")
    for job in waiting:
        cluster.wait_for_state(job, JobState.SUCCEEDED)
    assert cluster.job(waiting[1]).started_at < cluster.job(waiting[0]).started_at


def test_own_priorities(cluster):
    """An urgent job takes its owner's first place, and pushes no other owner out of theirs."""
    usual = [cluster.submit(frames=1, owner="a") for _ in range(2)]
    other = cluster.submit(frames=1, owner="b")
    urgent = cluster.submit(frames=1, owner="a", priority=1)
    order = sorted([*usual, other, urgent], key=cluster.queue.position)
    assert order == [other, urgent, *usual]  # both first places are equal; the older job leads
