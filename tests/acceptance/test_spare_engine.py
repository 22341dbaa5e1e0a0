"""A spare engine process is ready for the next job, computes one, and never stays behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from chamfer_morph.schemas import JobState
from morph_engine.child_process import python_command
from tests.patience import PATIENCE

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")

READY_SECONDS = 1.0
"""A spare process whose threads have all slept for so long waits for a job."""


@pytest.fixture
def cluster(new_cluster):
    """An empty cluster with spare engines: engine processes know of no database."""
    cluster = new_cluster("")
    cluster.environment["MORPH_WARM_ENGINES"] = "true"
    return cluster


def sleeps(process: psutil.Process) -> bool:
    """Whether all threads of a process wait for something."""
    try:
        threads = [psutil.Process(thread.id) for thread in process.threads()]
        return all(thread.status() == psutil.STATUS_SLEEPING for thread in threads)
    except psutil.NoSuchProcess:  # a thread has ended meanwhile
        return False


def spare_of(cluster, worker) -> psutil.Process:
    """The spare process of a worker, once it is ready."""
    cluster.wait_until(lambda: cluster.spare(worker) is not None, "a spare engine")
    spare, awake = cluster.spare(worker), time.monotonic()

    def is_ready() -> bool:
        nonlocal awake
        if not sleeps(spare):
            awake = time.monotonic()
        return time.monotonic() - awake > READY_SECONDS

    cluster.wait_until(is_ready, "the spare engine to be ready")
    return spare


def test_an_engine_has_no_network(cluster):
    """It is in one of its own, which has nobody in it, where the system lets a process go there."""
    if subprocess.run(python_command("chamfer_morph.worker.sandbox.network")).returncode:
        pytest.skip("This system gives processes no network of their own.")
    spare = spare_of(cluster, cluster.worker())
    assert os.readlink(f"/proc/{spare.pid}/ns/net") != os.readlink("/proc/self/ns/net")


def test_each_job_has_a_process_of_its_own(cluster, undisturbed):
    """The first takes the spare one, the second the next; the results are as without."""
    worker = cluster.worker()
    spare = spare_of(cluster, worker)
    first = cluster.submit()
    engine = cluster.engine(worker)
    assert engine == spare
    cluster.require_sound(first, undisturbed, kills=0)
    cluster.wait_until(lambda: not engine.is_running(), "the used engine to end")
    following = spare_of(cluster, worker)
    assert following != engine
    *_, likely, _ = following.cmdline()
    assert json.loads(likely)["method"] == "joint"  # as that of the first job
    second = cluster.submit()
    assert cluster.engine(worker) == following
    cluster.wait_for_state(second, JobState.SUCCEEDED)
    assert cluster.storage.job_dir(second).joinpath("log.txt").exists()


def test_a_job_takes_the_spare_process_that_still_gets_ready(cluster, undisturbed):
    """It skips the rest of that and begins; a second process would only take the cores from it."""
    worker = cluster.worker()
    cluster.wait_until(lambda: cluster.spare(worker) is not None, "a spare engine")
    spare = cluster.spare(worker)
    job = cluster.submit()
    assert cluster.engine(worker) == spare
    cluster.require_sound(job, undisturbed, kills=0)


@pytest.mark.faults
def test_a_dead_spare_is_replaced(cluster, undisturbed):
    """A job that comes meanwhile has a process of its own."""
    worker = cluster.worker()
    spare = spare_of(cluster, worker)
    spare.kill()
    job = cluster.submit()
    cluster.require_sound(job, undisturbed, kills=0)
    cluster.wait_until(lambda: cluster.spare(worker) not in (None, spare), "another spare")
    assert worker.poll() is None


@pytest.mark.faults
def test_a_killed_job_goes_on_in_another_process(cluster, undisturbed):
    """As without spare processes, and the cause names the signal."""
    worker = cluster.worker()
    spare_of(cluster, worker)
    job = cluster.submit()
    cluster.wait_for_frame(job, 3)
    killed = cluster.engine(worker)
    killed.send_signal(signal.SIGKILL)
    cluster.require_sound(job, undisturbed)
    problems = [e.data for e in cluster.storage.events(job).read() if e.type == "problem"]
    assert ["signal 9" in problem["cause"] for problem in problems] == [True]


def test_other_needs_have_a_fresh_process(cluster):
    """The spare one has started with another precision, and is left for the next job."""
    worker = cluster.worker()
    spare = spare_of(cluster, worker)
    job = cluster.submit(frames=1, precision="float64")
    assert cluster.engine(worker) != spare
    cluster.wait_for_state(job, JobState.SUCCEEDED)
    assert cluster.spare(worker) == spare


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.faults)]
)
def test_nothing_stays_behind(cluster, number):
    """Neither a spare process nor that of a job outlives the worker, however it ends."""
    worker = cluster.worker()
    spare_of(cluster, worker)
    job = cluster.submit(frames=120)
    cluster.submit()  # for which the next spare engine is started before this job ends
    cluster.wait_for_frame(job, 1)
    cluster.wait_until(lambda: cluster.spare(worker) is not None, "the next spare engine")
    family = [cluster.engine(worker), cluster.spare(worker)]
    worker.send_signal(number)
    worker.wait(PATIENCE)
    cluster.wait_until(lambda: not any(each.is_running() for each in family), "the end of all")


def test_while_no_job_waits_the_next_process_leaves_the_cores_to_this_one(cluster):
    """There is none before the job's own has ended."""
    worker = cluster.worker()
    spare_of(cluster, worker)
    job = cluster.submit(frames=40)
    cluster.wait_for_frame(job, 1)
    while not cluster.job(job).state.finished:
        assert not cluster.spare(worker) or not cluster.engines(worker)
    assert cluster.job(job).state is JobState.SUCCEEDED
    cluster.wait_until(lambda: cluster.spare(worker) is not None, "the next spare engine")


def test_none_is_kept_where_none_is_wanted(cluster):
    """By a setting."""
    worker = cluster.worker(MORPH_WARM_ENGINES="false")
    job = cluster.submit(frames=1)
    cluster.wait_for_state(job, JobState.SUCCEEDED)
    assert cluster.spare(worker) is None


def test_kernels_are_compiled_once(cluster, tmp_path):
    """The engine of the first job leaves them for all later ones.

    Taichi's cache is locked here by a process that has died long ago.
    """
    kernels = tmp_path / "kernels"
    kernels.mkdir()
    lock = kernels / "ticache.lock"
    lock.touch()
    os.utime(lock, (0, 0))
    cluster.environment["TI_OFFLINE_CACHE_FILE_PATH"] = str(kernels)
    worker = cluster.worker(MORPH_WARM_ENGINES="false")
    compiled = []
    for _ in range(2):
        job = cluster.submit(frames=1)
        cluster.wait_for_state(job, JobState.SUCCEEDED)
        cluster.wait_until(lambda: not cluster.engines(worker), "the end of the engine")
        compiled.append({file.name: file.stat().st_mtime for file in kernels.glob("*.tic")})
    assert compiled[0] == compiled[1] != {}
    assert not lock.exists()
