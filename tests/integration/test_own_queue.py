"""The order of an owner's own jobs, on SQLite and Postgres."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from chamfer_morph.schemas import BuiltInShape
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.queue import JobChangedError, JobQueue
from chamfer_morph.worker.settings import Settings
from morph_engine.presets import configure


@pytest.fixture
def queue(tmp_path: Path, database_url: str) -> Iterator[JobQueue]:
    """An empty queue."""
    settings = Settings(_env_file=None, data_dir=tmp_path, database_url=database_url)
    with closing(JobQueue(settings)) as queue:
        queue.migrate()
        yield queue


@pytest.fixture
def submit(queue: JobQueue) -> Callable[..., str]:
    """Queues a job of a priority, and of an owner."""
    spec = JobSpec(
        source=BuiltInShape(shape="sphere"),
        target=BuiltInShape(shape="star"),
        config=configure("fast").model_dump(mode="json"),
        timeout_seconds=60,
    )

    def enqueue(priority: int, owner: str = "ann") -> str:
        job = new_id()
        assert queue.enqueue(spec, job_id=job, owner=owner, priority=priority)
        return job

    return enqueue


def order(queue: JobQueue, *jobs: str) -> list[int | None]:
    """How many jobs start before each of these."""
    return [queue.position(job) for job in jobs]


def test_jobs_that_are_queued_at_once_take_their_turns(
    queue: JobQueue, submit: Callable[..., str]
) -> None:
    """Another owner's job waits for one of them, not for all that were given the same place."""
    with ThreadPoolExecutor(40) as pool:
        jobs = [*pool.map(submit, [100] * 40)]
    assert {*order(queue, *jobs)} == {*range(40)}
    assert order(queue, submit(100, "bob"))[0] in (0, 1, 2)
    with ThreadPoolExecutor(40) as pool:
        jobs += pool.map(submit, [100] * 20 + [1] * 20)
    assert order(queue, submit(100, "bob"))[0] in (1, 2, 3, 4)
    assert {*order(queue, *jobs)} < {*range(82)}


def test_an_urgent_job_overtakes(queue: JobQueue, submit: Callable[..., str]) -> None:
    """One that was queued later and is more urgent; equal ones keep their order."""
    first, second, urgent, last = (submit(priority) for priority in (100, 100, 1, 100))
    assert order(queue, urgent, first, second, last) == [0, 1, 2, 3]


@pytest.mark.parametrize("again", [JobQueue.retry, JobQueue.resume])
def test_a_job_that_is_queued_again_is_the_last(
    queue: JobQueue, submit: Callable[..., str], again: Callable[[JobQueue, str], None]
) -> None:
    """The place that it had once would be before those of others."""
    jobs = [submit(100) for _ in range(3)]
    queue.cancel(jobs[0])
    again(queue, jobs[0])
    assert order(queue, *jobs) == [2, 0, 1]


def test_a_job_that_was_put_first_is_first_again(
    queue: JobQueue, submit: Callable[..., str]
) -> None:
    """Its owner's wish holds when it is queued again."""
    jobs = [submit(100) for _ in range(3)]
    queue.put_first(jobs[2])
    assert order(queue, *jobs) == [1, 2, 0]
    queue.cancel(jobs[2])
    queue.resume(jobs[2])
    assert order(queue, *jobs) == [1, 2, 0]


def test_a_pause_and_its_end_at_once_leave_no_job_behind(
    queue: JobQueue, submit: Callable[..., str]
) -> None:
    """All jobs wait where the last of them has put them."""
    jobs = [submit(100) for _ in range(5)]
    with ThreadPoolExecutor(8) as pool:
        for _ in range(20):
            calls = [queue.pause, queue.unpause] * 4
            for call in [pool.submit(call, "ann") for call in calls]:
                call.result()
            paused = {job.paused for job in queue.newest()}
            assert paused == {queue.is_paused("ann")}
    queue.unpause("ann")
    assert None not in order(queue, *jobs)


def test_what_is_not_queued_cannot_be_put_first(
    queue: JobQueue, submit: Callable[..., str]
) -> None:
    """A job that has ended, or that there is not."""
    job = submit(100)
    queue.cancel(job)
    for gone in (job, new_id()):
        with pytest.raises(JobChangedError):
            queue.put_first(gone)
