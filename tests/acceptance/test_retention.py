"""Finished jobs go when they are too old or take too much space; so do abandoned uploads."""

from __future__ import annotations

import os
import sys
import time

import pytest

from chamfer_morph.schemas import JobState
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.janitor import delete_expired, delete_old
from chamfer_morph.worker.retention import deletions as broken_off
from chamfer_morph.worker.retention.abandoned_uploads import (
    ABANDONED_SECONDS,
    delete_abandoned_uploads,
)
from chamfer_morph.worker.retention.deletions import Deletions
from chamfer_morph.worker.retention.job_sizes import JobSizes
from chamfer_morph.worker.storage import Storage
from chamfer_morph.worker.webhooks.webhooks import Webhooks
from tests.patience import PATIENCE

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")


def test_retention(cluster):
    """By space the oldest go first; by age all finished ones; a queued job is never touched."""
    worker = cluster.worker()
    finished = [cluster.submit(frames=1) for _ in range(3)]
    for job in finished:
        cluster.wait_for_state(job, JobState.SUCCEEDED)
    worker.terminate()
    worker.wait(PATIENCE)
    queued = cluster.submit()
    storage, queue = cluster.storage, cluster.queue
    engine = database(cluster.settings)
    sizes, deletions = JobSizes(engine, queue, storage), Deletions(engine, queue, storage)
    assert delete_expired(cluster.settings, queue, sizes, deletions) == []

    room = storage.job_bytes(finished[2]) + storage.job_bytes(finished[1]) + 1
    by_space = cluster.settings.model_copy(update={"retention_bytes": room})
    assert delete_expired(by_space, queue, sizes, deletions) == [finished[0]]
    assert queue.get(finished[0]) is None
    assert not storage.job_dir(finished[0]).exists()

    time.sleep(0.1)
    by_age = cluster.settings.model_copy(update={"retention_days": 0.05 / 86400})
    assert set(delete_expired(by_age, queue, sizes, deletions)) == set(finished[1:])
    assert [record.id for record in queue.newest()] == [queued]
    engine.dispose()


def test_what_is_resumed_meanwhile_stays(cluster):
    """Between the janitor's look at the list and its turn, somebody may want a job again."""
    queue = cluster.queue
    engine = database(cluster.settings)
    deletions = Deletions(engine, queue, cluster.storage)
    job = cluster.submit()
    queue.cancel(job)
    seen = queue.get(job)
    queue.resume(job)
    assert not deletions.delete(seen)
    assert queue.get(job).state is JobState.QUEUED
    queue.cancel(job)
    assert not deletions.delete(seen), "it has ended again since"
    assert deletions.delete(queue.get(job))
    assert queue.get(job) is None
    engine.dispose()


def test_a_deletion_that_breaks_off(cluster, monkeypatch):
    """Its janitor does the rest later; a job whose row is still there stays."""
    storage, queue = cluster.storage, cluster.queue
    engine = database(cluster.settings)
    deletions = Deletions(engine, queue, storage)
    gone, kept, other = (cluster.submit() for _ in range(3))
    for job in (gone, kept, other):
        storage.claim(job, 0)
        queue.cancel(job)

    for job, owner, name in ((gone, storage, "remove_job"), (kept, queue, "delete_finished")):
        with monkeypatch.context() as patch, pytest.raises(SystemExit):
            patch.setattr(owner, name, stop)  # killed here
            deletions.delete(queue.get(job))
    assert storage.job_dir(gone).exists()
    assert deletions.finish() == []  # somebody may be at it
    assert deletions.finish(abandoned_seconds=0) == [gone]
    assert [storage.job_dir(job).exists() for job in (gone, kept, other)] == [False, True, True]
    assert {record.id for record in queue.newest()} == {kept, other}
    assert deletions.finish(abandoned_seconds=0) == []
    engine.dispose()


def test_abandoned_uploads(tmp_path):
    """What a killed API had received goes after a while; an upload that still grows stays."""
    storage = Storage(tmp_path)
    abandoned, growing = storage.uploads / "old.part", storage.uploads / "new.part"
    abandoned.touch()
    growing.touch()
    long_ago = time.time() - ABANDONED_SECONDS - 1
    os.utime(abandoned, (long_ago, long_ago))
    assert delete_abandoned_uploads(storage) == ["old.part"]
    assert list(storage.uploads.iterdir()) == [growing]


def test_nothing_goes_for_its_age_while_the_clock_is_doubted(cluster, monkeypatch):
    """Neither an upload nor what a deletion has left, which a right clock lets go."""
    storage, queue = cluster.storage, cluster.queue
    engine = database(cluster.settings)
    sizes, deletions = JobSizes(engine, queue, storage), Deletions(engine, queue, storage)
    job = cluster.submit()
    storage.claim(job, 0)
    queue.cancel(job)
    monkeypatch.setattr(storage, "remove_job", stop)
    with pytest.raises(SystemExit):
        deletions.delete(queue.get(job))
    monkeypatch.undo()
    upload = storage.uploads / "old.part"
    upload.touch()
    long_ago = time.time() - ABANDONED_SECONDS - 1
    os.utime(upload, (long_ago, long_ago))
    monkeypatch.setattr(broken_off.time, "time", lambda: long_ago + 3 * ABANDONED_SECONDS)
    arguments = cluster.settings, queue, storage, sizes, deletions, Webhooks(engine)
    delete_old(*arguments, steady=False)
    assert upload.exists() and storage.job_dir(job).exists()
    delete_old(*arguments, steady=True)
    assert not upload.exists() and not storage.job_dir(job).exists()
    engine.dispose()


def stop(*_):
    """In place of the end of a process."""
    raise SystemExit
