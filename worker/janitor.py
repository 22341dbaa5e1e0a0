"""Adoption of jobs whose worker is gone, retention of finished ones, and what a kill left over."""

from __future__ import annotations

import contextlib
import logging
import subprocess
import time
from datetime import datetime, timedelta, timezone

from chamfer_morph.schemas import JobState
from chamfer_morph.worker.locks import try_lock
from chamfer_morph.worker.queue import JobQueue, JobRecord
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from morph_engine.child_process import python_command

log: logging.Logger = logging.getLogger(__name__)

FINISHED = [state for state in JobState if state.finished]
ADOPTION_LIMIT_SECONDS = 70.0
"""After this an adoption is killed; it ends itself sooner, unless somebody has stopped it."""
RETENTION_SECONDS = 60.0
ABANDONED_SECONDS = 3600.0
"""An upload that has not grown for so long belongs to nobody: its API was killed."""


def adopt_orphans(settings: Settings, queue: JobQueue) -> list[str]:
    """Put the jobs of dead workers back into the queue.

    A short-lived process takes on the name of each dead worker: at its start it finds the jobs
    that the worker left and queues them again. The worker's lock, held meanwhile, keeps a second
    janitor and the worker itself away.

    Returns:
        Names of the workers found dead.
    """
    dead = []
    for executor in queue.running():
        lock = try_lock(settings, executor)
        if lock is None:
            continue
        try:
            if executor not in queue.running():  # another janitor came first
                continue
            log.warning("worker %s is gone; its jobs go back into the queue", executor)
            subprocess.run(
                python_command("chamfer_morph.worker", "adopt", executor),
                timeout=ADOPTION_LIMIT_SECONDS, check=True,
            )  # fmt: skip
            dead.append(executor)
        finally:
            lock.release()
    return dead


def delete_expired(settings: Settings, queue: JobQueue) -> list[str]:
    """Delete finished jobs that are too old, and the oldest beyond the allowed space.

    Returns:
        Ids of the deleted jobs.
    """
    storage = Storage(settings.data_dir)
    deleted = []
    for record in queue.all(states=FINISHED):
        if _is_expired(settings, record) and delete_if_unchanged(queue, storage, record):
            deleted.append(record.id)
    if settings.retention_bytes:
        kept = 0
        for record in queue.all(states=FINISHED):
            kept += storage.job_bytes(record.id)
            if kept > settings.retention_bytes and delete_if_unchanged(queue, storage, record):
                deleted.append(record.id)
    return deleted


def delete_if_unchanged(queue: JobQueue, storage: Storage, record: JobRecord) -> bool:
    """Delete a finished job, unless somebody has resumed, retried or deleted it since its record
    was read.

    Returns:
        Whether it has been deleted.
    """  # noqa: D205
    now = queue.get(record.id)
    if now is None or now.finished_at != record.finished_at:
        return False
    log.info("job %s has expired", record.id)
    queue.delete(record.id)
    storage.remove_job(record.id)
    return True


def delete_abandoned_uploads(storage: Storage) -> list[str]:
    """Delete what an API that was killed had received of files.

    Returns:
        Names of the deleted files.
    """
    deleted = []
    for path in storage.uploads.iterdir():
        with contextlib.suppress(FileNotFoundError):  # it has arrived meanwhile
            if time.time() - path.stat().st_mtime > ABANDONED_SECONDS:
                path.unlink()
                deleted.append(path.name)
    return deleted


def run(settings: Settings) -> None:
    """Do all of it for ever."""
    queue = JobQueue(settings)
    queue.migrate()
    next_deletion = 0.0
    while True:
        try:
            adopt_orphans(settings, queue)
            if time.monotonic() > next_deletion:
                delete_expired(settings, queue)
                delete_abandoned_uploads(Storage(settings.data_dir))
                next_deletion = time.monotonic() + RETENTION_SECONDS
        except Exception:  # the database is away, or an adoption failed: try again
            log.exception("the janitor has to try again")
        time.sleep(settings.adoption_seconds)


def _is_expired(settings: Settings, record: JobRecord) -> bool:
    age = datetime.now(timezone.utc) - (record.finished_at or record.created_at)
    return settings.retention_days > 0 and age > timedelta(days=settings.retention_days)
