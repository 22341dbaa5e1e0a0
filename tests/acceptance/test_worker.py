"""The walking path of the worker room; `test_faults.py` has all that may go wrong on it."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from chamfer_morph.schemas import BuiltInShape, JobState, MeshShape
from chamfer_morph.server.failure_counts import FailureCounts
from chamfer_morph.worker import service_log
from chamfer_morph.worker.adoptions import Adoptions
from chamfer_morph.worker.alarm import SETTLING_PAUSE_SECONDS, SETTLING_SECONDS
from chamfer_morph.worker.engines.engine import Engine
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.liveness import LIMIT_SECONDS
from chamfer_morph.worker.slots import executor_id, janitor_id
from chamfer_morph.worker.storage import Storage
from morph_engine.presets import configure
from tests.acceptance.conftest import POSTGRES_BY_FAULT_TESTS, SPHERE
from tests.patience import PATIENCE

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
    """Cancelling ends the engine before its job is done; resuming uses the frames it left."""
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 2)
    engine = cluster.engine(worker)
    cluster.queue.cancel(job)
    cluster.wait_until(lambda: not engine.is_running(), "the engine to end")
    assert 2 < len(cluster.frames(job)) < len(undisturbed)
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
    cluster.wait_until(lambda: Adoptions(cluster.database).total() == 1, "the count of adoptions")


def test_a_slot_that_is_told_to_end_is_forgotten(cluster):
    """At once: only one that is killed is missed."""
    worker = cluster.worker()
    cluster.wait_for_state(cluster.submit(frames=1), JobState.SUCCEEDED)
    assert cluster.slots.all() == {executor_id(0): False}
    worker.terminate()
    assert worker.wait() == 0
    assert cluster.slots.all() == {}


def test_a_worker_that_starts_paused_says_so(cluster):
    """Pauses outlive an upgrade, and whoever waits for its jobs looks into the log."""
    cluster.slots.register(executor_id(0))
    cluster.slots.pause(executor_id(0))
    cluster.worker()
    log = cluster.settings.data_dir / "processes.log"
    cluster.wait_until(lambda: "WARNING" in log.read_text(), "the warning")
    assert f"{executor_id(0)} is paused" in log.read_text()
    assert "morph workers unpause" in log.read_text()


@pytest.mark.parametrize("process", ["worker", "janitor"])
def test_a_probe_tells_a_process_that_hangs(new_cluster, process):
    """Whoever looks after containers asks so; one that goes on again is alive again."""
    cluster = new_cluster("")
    name = executor_id(0) if process == "worker" else janitor_id()
    file = cluster.settings.data_dir / "locks" / f"{name}.alive"

    def alive() -> bool:
        return cluster.start("alive", process).wait() == 0

    assert not alive()
    started = cluster.start("run" if process == "worker" else process)
    cluster.wait_until(alive, "a sign of life")
    started.send_signal(signal.SIGSTOP)
    assert alive()
    long_ago = time.time() - 2 * LIMIT_SECONDS
    os.utime(file, (long_ago, long_ago))
    assert not alive()
    started.send_signal(signal.SIGCONT)
    cluster.wait_until(alive, "another sign of life")


@POSTGRES_BY_FAULT_TESTS
def test_failures_are_counted_by_kind(cluster):
    """Each once; one that fails again counts again; what was before the counting began does not."""
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
    later = FailureCounts(cluster.queue)
    assert later.since_last_call() == {}
    assert cluster.queue.delete_finished(cluster.job(late))
    assert later.since_last_call() == counts.since_last_call() == {}
    finished = cluster.job(gone).finished_at
    cluster.queue.retry(gone)
    cluster.wait_until(
        lambda: cluster.job(gone).finished_at not in (None, finished), "the job to fail once more"
    )
    assert later.since_last_call() == counts.since_last_call() == {"input": 1}


@pytest.mark.parametrize("log_format", ["text", "json"])
def test_the_last_words_of_an_engine_name_no_folder(new_cluster, log_format):
    """What it wrote last is quoted, without telling where programs and files lie."""
    cluster = new_cluster("")
    worker = cluster.worker(MORPH_ATTEMPTS="1")
    job = cluster.submit()
    cluster.wait_for_frame(job, 1)
    engine, log = cluster.engine(worker), cluster.storage.job_dir(job) / "log.txt"
    folders = sys.prefix, sys.base_prefix, str(Path.home()), str(cluster.settings.data_dir)
    engine.suspend()
    words = " ".join(f"{folder}/inner/file.so" for folder in folders) + ": broken"
    with log.open("a") as file:
        file.write((json.dumps({"message": words}) if log_format == "json" else words) + "\n")
    engine.send_signal(signal.SIGABRT)
    engine.resume()
    problem = cluster.wait_for_state(job, JobState.FAILED).problem
    assert problem.kind == "crash"
    assert problem.cause.endswith(
        "Its last output: " + " ".join(4 * ["inner/file.so"]) + ": broken"
    )


@POSTGRES_BY_FAULT_TESTS
def test_a_job_that_takes_too_much_memory_is_stopped(cluster):
    """It fails once, with the cause; where it has more memory it goes on from its last frame."""
    tight = cluster.worker(MORPH_JOB_MEMORY_BYTES=str(150_000_000))
    job = cluster.submit()
    problem = cluster.wait_for_state(job, JobState.FAILED).problem
    assert problem.kind == "resources"
    assert "the limit of 150 MB per job" in problem.cause
    assert tight.poll() is None
    assert not cluster.engines(tight)
    tight.terminate()
    tight.wait(PATIENCE)
    cluster.worker()
    cluster.queue.resume(job)
    cluster.wait_for_state(job, JobState.SUCCEEDED)


@POSTGRES_BY_FAULT_TESTS
def test_a_job_that_fills_too_much_disk_is_stopped(cluster):
    """It fails once, with the cause, and keeps its frames; with more disk it goes on."""
    tight = cluster.worker(MORPH_DISK_BYTES_PER_KEY=str(1_000_000))
    job = cluster.submit(frames=10_000, states_every=1)
    problem = cluster.wait_for_state(job, JobState.FAILED).problem
    assert problem.kind == "resources"
    assert "0.0 GB" in problem.cause and "MORPH_DISK_BYTES_PER_KEY" in problem.remedy
    assert tight.poll() is None
    kept = len(cluster.frames(job))
    assert 0 < kept < 10_000
    tight.terminate()
    tight.wait(PATIENCE)
    cluster.worker()
    cluster.queue.resume(job)
    cluster.wait_for_frame(job, kept + 1)


@pytest.mark.skipif(sys.platform != "linux", reason="nothing else counts what a process takes")
def test_an_engine_takes_no_memory_beyond_its_limit(tmp_path):
    """Not even between two looks of its worker: it fails with the cause, and has not had it."""
    job_dir = tmp_path / "jobs" / "job"
    job_dir.mkdir(parents=True)
    settings = {"method": "joint", "sampling.points_per_cell_edge": 1, "grid.half_extent": 120}
    star = BuiltInShape(shape="star")
    config = configure("fast", settings | {"frames": 1})
    spec = JobSpec(source=SPHERE, target=star, config=config, device="cpu", timeout_seconds=600)
    (job_dir / "spec.json").write_text(spec.model_dump_json(), encoding="utf-8")
    engine = Engine(1, Storage(tmp_path))
    engine.assign(job_dir, 1, 100_000_000)
    while not engine.ended:
        engine.beat()
        time.sleep(0.1)
    engine.wait()
    assert engine.problem is not None and engine.problem.kind == "resources"
    assert "the limit is 100 MB per job" in engine.problem.cause
    assert engine.peak_memory < 3e9, "which takes 5.8 GB without a limit"


def test_an_engine_logs_as_its_service_does(tmp_path):
    """Each line is JSON, with the ids of job and request, an exception that ends it included."""
    storage = Storage(tmp_path)
    job_dir = storage.job_dir("01JOB")
    job_dir.mkdir()
    (job_dir / "spec.json").write_text("{}")
    token = service_log.request_id.set("click-1")
    engine = Engine(1, storage, log_format="json", job_dir=job_dir)
    engine.assign(job_dir, 1, 1 << 30)
    service_log.request_id.reset(token)
    while not engine.ended:
        engine.beat()
        time.sleep(0.1)
    assert engine.wait() == 1
    lines = [json.loads(line) for line in (job_dir / "log.txt").read_text().splitlines()]
    assert lines and "ValidationError" in lines[-1]["error"]
    assert {(line["job"], line["request"]) for line in lines} == {("01JOB", "click-1")}


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
