"""The fault matrix: whatever dies, no job is lost, none is done twice, and its state is true."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path

import psutil
import psycopg
import pytest

from chamfer_morph.schemas import JobState
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.janitor import adopt_orphans
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.slots import executor_id
from morph_engine.sections import GridConfig
from tests.acceptance.conftest import FRAMES, Cluster
from tests.patience import PATIENCE

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX"),
]


def test_worker_killed_and_restarted(cluster, undisturbed):
    """A worker that comes back takes up its job after the last frame."""
    cluster.environment["MORPH_WARM_ENGINES"] = "true"
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 3)
    worker.kill()
    worker.wait()
    cluster.worker()
    cluster.require_sound(job, undisturbed)


def test_all_killed_at_once(cluster, undisturbed):
    """Workers, engines and janitor die together; what starts afterwards finishes everything."""
    cluster.environment["MORPH_WARM_ENGINES"] = "true"
    slots = [cluster.worker(0), cluster.worker(1)]
    jobs = [cluster.submit() for _ in range(3)]
    janitor = cluster.start("janitor")
    cluster.wait_for_frame(jobs[0], 2)
    engines = [child for w in slots for child in psutil.Process(w.pid).children()]
    for process in (*slots, janitor, *engines):
        process.kill()
    for worker in slots:
        worker.wait()
    cluster.worker(0)
    cluster.worker(1)
    for job in jobs:
        cluster.require_sound(job, undisturbed)


def test_two_janitors_adopt_once(cluster, undisturbed):
    """Two janitors that see the same dead worker do not get in each other's way."""
    worker = cluster.worker(0)
    job = cluster.submit()
    cluster.wait_for_frame(job, 1)
    worker.kill()
    worker.wait()
    cluster.start("janitor")
    cluster.start("janitor")
    cluster.wait_for_state(job, JobState.QUEUED)
    cluster.worker(1)
    cluster.require_sound(job, undisturbed)
    log = (cluster.settings.data_dir / "processes.log").read_text()
    assert log.count("is gone; its jobs are put back into the queue") == 1


def test_a_janitor_that_comes_too_late_adopts_nothing(cluster, monkeypatch):
    """It saw the dead worker's job before another janitor adopted it, and locked after that."""

    class Interrupted(JobQueue):
        seen = 0

        def running(self) -> dict[str, set[str]]:
            found = super().running()
            self.seen += 1
            if self.seen == 1:
                assert adopt_orphans(cluster.settings, cluster.queue) == [executor_id(0)]
            return found

    worker = cluster.worker(0)
    job = cluster.submit()
    cluster.wait_for_frame(job, 1)
    worker.kill()
    worker.wait()
    for name, value in cluster.environment.items():
        monkeypatch.setenv(name, value)
    with closing(Interrupted(cluster.settings)) as queue:
        assert adopt_orphans(cluster.settings, queue) == []
    assert cluster.job(job).state is JobState.QUEUED


def test_duplicate_executor(cluster):
    """A second worker under the same name refuses to start."""
    cluster.worker(0)
    cluster.wait_until(lambda: executor_id(0) in cluster.slots.all(), "the first worker")
    second = cluster.worker(0)
    assert second.wait(30) == ExitCode.REFUSED
    log = (cluster.settings.data_dir / "processes.log").read_text()
    assert "choose another --first-slot" in log


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGKILL])
def test_engine_crash(cluster, undisturbed, number):
    """An engine that crashes, or that the system kills for memory, costs an attempt only."""
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 3)
    cluster.engine(worker).send_signal(number)
    cluster.require_sound(job, undisturbed)
    problems = [e.data for e in cluster.storage.events(job).read() if e.type == "problem"]
    assert [problem["retry"] for problem in problems] == [True]
    assert f"signal {int(number)}" in problems[0]["cause"]


def test_engine_hangs(cluster, undisturbed):
    """An engine that finishes nothing for too long is stopped and started again."""
    worker = cluster.worker(MORPH_STALL_SECONDS="40")  # longer than an engine takes to start
    job = cluster.submit()
    cluster.wait_for_frame(job, 3)
    cluster.engine(worker).send_signal(signal.SIGSTOP)
    cluster.require_sound(job, undisturbed)
    problems = [e.data["kind"] for e in cluster.storage.events(job).read() if e.type == "problem"]
    assert problems == ["hang"]


def test_poison(cluster):
    """An engine that dies in every attempt fails its job after three, with the cause."""
    worker = cluster.worker()
    job = cluster.submit()
    deadline = time.monotonic() + PATIENCE
    while not cluster.job(job).state.finished and time.monotonic() < deadline:
        for engine in cluster.engines(worker):
            with suppress(psutil.Error):  # it has ended
                engine.kill()
        time.sleep(0.05)
    record = cluster.job(job)
    assert record.state is JobState.FAILED
    assert "signal 9" in record.problem.cause
    assert record.problem.remedy
    assert worker.poll() is None


def test_input_error_is_not_tried_again(cluster):
    """What the engine refuses fails at once, with its cause and remedy."""
    cluster.worker()
    job = cluster.submit()
    spec = cluster.job(job).spec
    cluster.queue.cancel(job)
    config = spec.config.model_copy(update={"grid": GridConfig(half_extent=4.0)})
    refused = spec.model_copy(update={"config": config})
    cluster.queue.enqueue(refused, job_id="refused", owner="")
    record = cluster.wait_for_state("refused", JobState.FAILED)
    assert record.problem.kind == "input"
    assert record.problem.remedy
    types = [event.type for event in cluster.storage.events("refused").read()]
    assert types.count("problem") == 1


def test_worker_stopped_longer_than_its_lease(cluster, undisturbed):
    """A worker that sleeps through its lease does no harm when it wakes up."""
    worker = cluster.worker(0)
    job = cluster.submit()
    cluster.wait_for_frame(job, 2)
    worker.send_signal(signal.SIGSTOP)
    cluster.worker(1)
    cluster.start("janitor")
    if cluster.settings.on_postgres:  # the server takes the lease; a file lock stays
        cluster.wait_until(
            lambda: cluster.job(job).executor == executor_id(1), "another worker to go on"
        )
    else:
        time.sleep(8)
    worker.send_signal(signal.SIGCONT)
    cluster.require_sound(job, undisturbed, kills=2)


def test_cancel_while_queued(cluster):
    """A cancelled job that never started leaves nothing."""
    job = cluster.submit()
    cluster.queue.cancel(job)
    assert cluster.job(job).state is JobState.CANCELLED
    cluster.worker()
    other = cluster.submit(frames=1)
    cluster.wait_for_state(other, JobState.SUCCEEDED)
    assert cluster.frames(job) == []


def test_cancel_while_finishing(cluster, undisturbed):
    """A job cancelled while its result is written has either succeeded or can be resumed."""
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, len(undisturbed) - 1)
    cluster.queue.cancel(job)  # changes nothing if the job was faster
    state = cluster.wait_for_state(job, JobState.SUCCEEDED, JobState.CANCELLED).state
    cluster.wait_until(lambda: not cluster.engines(worker), "the engine to end")
    assert cluster.job(job).state is state
    if state is JobState.CANCELLED:
        cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed, kills=0)


def test_cancel_while_waiting_to_retry(cluster):
    """A job that waits for its next attempt can be cancelled."""
    worker = cluster.worker(MORPH_RETRY_SECONDS="30")
    job = cluster.submit()
    cluster.engine(worker).kill()
    cluster.wait_until(
        lambda: any(e.type == "problem" for e in cluster.storage.events(job).read()), "a failure"
    )
    cluster.queue.cancel(job)
    other = cluster.submit(frames=1)
    cluster.wait_for_state(other, JobState.SUCCEEDED)
    assert cluster.job(job).state is JobState.CANCELLED


def test_timeout(cluster):
    """A job that runs too long is timed out, says so, and can be resumed."""
    worker = cluster.worker()
    job = cluster.submit(timeout=15, frames=4000)
    record = cluster.wait_for_state(job, JobState.TIMED_OUT, JobState.CANCELLED)
    assert record.state is JobState.TIMED_OUT
    assert "15 s" in record.problem.cause
    cluster.wait_until(lambda: not cluster.engines(worker), "the engine to end")
    done = len(cluster.frames(job))
    assert done > 0
    cluster.queue.resume(job)
    cluster.wait_until(lambda: len(cluster.frames(job)) > done, "the job to go on")
    assert cluster.frames(job) == list(range(len(cluster.frames(job))))


def test_traces_of_a_kill_in_the_wrong_moment(cluster, undisturbed):
    """Half-written files and a frame beyond the checkpoint do not stop a job from going on."""
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 4)
    cluster.queue.cancel(job)
    cluster.wait_until(lambda: not cluster.engines(worker), "the engine to end")
    spool = cluster.storage.job_dir(job) / "result.vtkhdf.spool"
    folder = cluster.storage.job_dir(job)
    (spool / "frame-000099.npz.tmp").write_bytes(b"half a frame")
    (spool / "checkpoint.npz.tmp").write_bytes(b"half a checkpoint")
    (folder / "result.vtkhdf.tmp").write_bytes(b"half a result")
    with (folder / "events.jsonl").open("ab") as log:
        log.write(b'{"at": "2026-')
    cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed)


def test_killed_between_result_and_report(cluster, undisturbed):
    """A result that was finished but not reported is found, not computed again."""
    cluster.worker()
    job = cluster.submit()
    cluster.wait_for_state(job, JobState.SUCCEEDED)
    before = cluster.frames(job)
    cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed, kills=0)
    assert cluster.frames(job) == before


@pytest.mark.parametrize("file", ["checkpoint.npz", "frame-000001.npz", "run.json"])
def test_corrupt_spool(cluster, undisturbed, file):
    """A damaged checkpoint, frame or record costs the work done, not the job."""
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 3)
    cluster.queue.cancel(job)
    cluster.wait_until(lambda: not cluster.engines(worker), "the engine to end")
    path = cluster.storage.job_dir(job) / "result.vtkhdf.spool" / file
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed, kills=20)


def test_upgrade_with_queued_and_running_jobs(cluster, undisturbed):
    """A newer program finishes what an older one began."""
    worker = cluster.worker()
    running, queued = cluster.submit(), cluster.submit()
    cluster.wait_for_frame(running, 3)
    worker.send_signal(signal.SIGTERM)
    assert worker.wait(PATIENCE) == 0
    record = cluster.storage.job_dir(running) / "result.vtkhdf.spool" / "run.json"
    text = record.read_text()
    assert '"chamfer-morph": "' in text
    record.write_text(text.replace('"chamfer-morph": "', '"chamfer-morph": "0.0.'))
    cluster.worker()
    cluster.require_sound(running, undisturbed)
    cluster.require_sound(queued, undisturbed, kills=0)


def test_same_id_twice(cluster):
    """A job submitted twice under one id is one job."""
    job = cluster.submit()
    assert not cluster.queue.enqueue(cluster.job(job).spec, job_id=job, owner="")
    assert [record.id for record in cluster.queue.newest()] == [job]


def test_owners_take_turns(cluster):
    """Behind 12 jobs of one key, the first three of another are among the first six to start."""
    for _ in range(12):
        cluster.submit(frames=1, owner="greedy")
    modest = [cluster.submit(frames=1, owner="modest") for _ in range(3)]
    cluster.worker()
    for job in modest:
        cluster.wait_for_state(job, JobState.SUCCEEDED)
    started = sorted(
        (r for r in cluster.queue.newest() if r.started_at), key=lambda record: record.started_at
    )
    assert {r.id for r in started[:7]} >= set(modest)


def test_paused_worker_takes_no_job(cluster, undisturbed):
    """A paused slot finishes its job and takes no other; unpaused it goes on."""
    cluster.worker(0)
    first, second = cluster.submit(), cluster.submit()
    cluster.wait_for_frame(first, 1)
    cluster.slots.pause(executor_id(0))
    cluster.require_sound(first, undisturbed, kills=0)
    time.sleep(1)
    assert cluster.frames(second) == []
    cluster.start("janitor")
    cluster.worker(1)
    cluster.require_sound(second, undisturbed, kills=0)
    assert cluster.job(second).executor == executor_id(1)


def test_locked_database(new_cluster, undisturbed):
    """A job outlives 45 seconds in which somebody else locks SQLite."""
    cluster = new_cluster("")
    cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 2)
    with closing(sqlite3.connect(cluster.settings.data_dir / "morph.sqlite")) as connection:
        connection.execute("begin exclusive")
        time.sleep(45)
    cluster.require_sound(job, undisturbed, kills=0)


def test_database_restarts(new_cluster, own_postgres, undisturbed):
    """Postgres is away for eight seconds in the middle of a job; later jobs run as well.

    The worker has lost its lease by then and ends; here as under `morph serve` it is started again.
    """
    cluster = new_cluster(own_postgres.url)
    worker = cluster.worker()
    cluster.start("janitor")
    job = cluster.submit()
    cluster.wait_for_frame(job, 2)
    own_postgres.run("stop")
    time.sleep(8)
    own_postgres.run("start")
    later = cluster.submit(frames=1)
    while not cluster.job(later).state.finished:
        if worker.poll() is not None:
            worker = cluster.worker()
        time.sleep(0.5)
    cluster.require_sound(job, undisturbed, kills=2)
    assert cluster.job(later).state is JobState.SUCCEEDED


def test_database_restarts_while_jobs_are_queued(new_cluster, own_postgres):
    """Whoever submits again under the same id until there is an answer has queued one job each."""
    cluster = new_cluster(own_postgres.url)
    spec = cluster.job(cluster.submit(frames=1)).spec
    wanted = [new_id() for _ in range(60)]

    def enqueue(job_id):
        while True:
            try:
                return cluster.queue.enqueue(spec, job_id=job_id, owner="")
            except Exception:
                time.sleep(0.1)

    with ThreadPoolExecutor(4) as pool:
        queued = pool.map(enqueue, wanted)
        time.sleep(0.1)
        own_postgres.run("stop")
        time.sleep(3)
        own_postgres.run("start")
        assert len(list(queued)) == len(wanted)
    found = [record.id for record in cluster.queue.newest(limit=1000)]
    assert len(found) == len(wanted) + 1
    assert set(wanted) < set(found)


def put_jobs_on(disk: Path, cluster: Cluster) -> None:
    """Let a disk of their own hold the files of jobs."""
    (disk / "jobs").mkdir()
    jobs = cluster.settings.data_dir / "jobs"
    jobs.rmdir()
    jobs.symlink_to(disk / "jobs")


def fill_disk(folder: Path, *, but: int = 0) -> Path:
    """Fill a disk, but for some bytes; returns the file that does."""
    filling = folder / "filling"
    with suppress(OSError), filling.open("wb") as file:
        while True:
            file.write(bytes(1 << 12))
            file.flush()
    os.truncate(filling, filling.stat().st_size - but)
    return filling


def test_disk_full(new_cluster, small_disk, undisturbed):
    """A job that finds the disk full fails and says so; with room again, resume finishes it."""
    cluster = new_cluster("")
    put_jobs_on(small_disk, cluster)
    cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 1)
    filling = fill_disk(small_disk)
    record = cluster.wait_for_state(job, JobState.FAILED)
    told = f"{record.problem.cause} {record.problem.remedy}"
    assert "space" in told and f"{cluster.settings.data_dir}" not in told
    filling.unlink()
    cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed, kills=2)


def test_too_little_disk_for_a_job(new_cluster, small_disk):
    """It is refused before its first frame, with what can be done about the disk of a service."""
    cluster = new_cluster("")
    put_jobs_on(small_disk, cluster)
    fill_disk(small_disk, but=1 << 20)
    cluster.worker()
    problem = cluster.wait_for_state(cluster.submit(), JobState.FAILED).problem
    assert "MB of disk" in problem.cause and problem.kind == "resources"
    assert "MORPH_DATA_DIR" in problem.remedy and "`out`" not in problem.remedy


def test_disk_full_as_the_result_is_written(new_cluster, small_disk, undisturbed):
    """The job fails and says so; with room again, resume writes it, and computes no frame again."""
    cluster = new_cluster("")
    put_jobs_on(small_disk, cluster)
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, FRAMES * 2 // 3)
    engine = cluster.engine(worker)
    engine.suspend()
    # enough for the other frames; a result has all positions, and more
    filling = fill_disk(small_disk, but=undisturbed.nbytes)
    engine.resume()
    record = cluster.wait_for_state(job, JobState.FAILED)
    assert cluster.frames(job) == [*range(FRAMES)]
    assert "No space" in record.problem.cause and record.problem.kind == "resources"
    assert not cluster.storage.result_path(job).exists()
    filling.unlink()
    cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed, kills=0)


def test_disk_that_becomes_read_only(new_cluster, small_disk, undisturbed):
    """A job whose engine is gone fails and says so; resumed on a disk that is well, it goes on."""
    cluster = new_cluster("")
    put_jobs_on(small_disk, cluster)
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, FRAMES // 3)
    engine = cluster.engine(worker)
    worker.send_signal(signal.SIGSTOP)
    engine.kill()  # it would have files open, with which no disk becomes read-only
    cluster.wait_until(lambda: remount(small_disk, "ro"), "the disk to become read-only")
    worker.send_signal(signal.SIGCONT)
    record = cluster.wait_for_state(job, JobState.FAILED)
    assert "Read-only" in record.problem.cause and record.problem.kind == "resources"
    assert worker.poll() is None
    assert remount(small_disk, "rw")
    cluster.queue.resume(job)
    cluster.require_sound(job, undisturbed)


def remount(folder: Path, how: str) -> bool:
    """Let a disk be read-only (`ro`) or not (`rw`); False while files are written to."""
    command = ["mount", "-o", f"remount,{how}", folder]
    return subprocess.run(command, check=False, capture_output=True).returncode == 0


def test_disk_of_database_and_data_full(new_cluster, small_disk, undisturbed):
    """The worker ends, for it can report nothing; started again with room, it finishes the job."""
    cluster = new_cluster("", small_disk / "data")
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 1)
    filling = fill_disk(small_disk)
    assert worker.wait(60) == ExitCode.DATABASE_REFUSES
    assert cluster.job(job).state is JobState.RUNNING
    filling.unlink()
    cluster.worker()
    cluster.require_sound(job, undisturbed, kills=2)


REFUSING_ONCE = """
import sys
from pathlib import Path
import psycopg, sqlite3
import sqlalchemy as sa
from chamfer_morph.worker.__main__ import main
refused, error = Path(sys.argv.pop(1)), eval(sys.argv.pop(1))
@sa.event.listens_for(sa.Engine, "do_execute")
def refuse(cursor, statement, parameters, context):
    values = parameters.values() if isinstance(parameters, dict) else parameters
    if statement.startswith(("UPDATE", "WITH")) and "SUCCESS" in values and not refused.exists():
        refused.touch()
        raise error
main()
"""
"""A worker to whom the database refuses the outcome of its job, the first time."""


@pytest.mark.parametrize(
    "error",
    [
        "sqlite3.OperationalError('disk I/O error')",
        "sqlite3.OperationalError('attempt to write a readonly database')",
        "sqlite3.OperationalError('unable to open database file')",
        "psycopg.errors.ReadOnlySqlTransaction('read-only')",
    ],
)
def test_database_that_refuses_an_outcome(new_cluster, tmp_path, request, undisturbed, error):
    """The worker ends, for nobody repeats it; started again, it reports what it has computed."""
    on_postgres = error.startswith("psycopg")
    cluster = new_cluster(request.getfixturevalue("own_postgres").url if on_postgres else "")
    refused = tmp_path / "refused"
    worker = cluster.program(REFUSING_ONCE, f"{refused}", error, "run")
    job = cluster.submit()
    assert worker.wait(PATIENCE) == ExitCode.DATABASE_REFUSES
    assert refused.exists() and cluster.job(job).state is JobState.RUNNING
    cluster.worker()
    cluster.require_sound(job, undisturbed, kills=0)


def test_database_that_becomes_read_only(new_cluster, own_postgres, undisturbed):
    """The same for Postgres in the middle of a job; writable again, the job goes on."""
    cluster = new_cluster(own_postgres.url)
    worker = cluster.worker()
    job = cluster.submit()
    cluster.wait_for_frame(job, 2)
    set_read_only(own_postgres.url, "on")
    assert worker.wait(PATIENCE) == ExitCode.DATABASE_REFUSES
    set_read_only(own_postgres.url, "off")
    assert cluster.job(job).state is JobState.RUNNING
    cluster.worker()
    cluster.require_sound(job, undisturbed, kills=2)


def set_read_only(server: str, how: str) -> None:
    """Let all databases of a server be read-only (`on`) or not (`off`)."""
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute("set default_transaction_read_only = off")
        connection.execute(f"alter system set default_transaction_read_only = {how}")
        connection.execute("select pg_reload_conf()")
