"""Adoption of jobs whose worker is gone, retention of finished ones, and what a kill left over.

The process sends messages to webhooks, too.
"""

from __future__ import annotations

import logging
import subprocess
import time
from collections.abc import Callable

from chamfer_morph.worker import liveness, service_log
from chamfer_morph.worker.absent_slots import AbsentSlots
from chamfer_morph.worker.adoptions import Adoptions
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.locks import try_lock
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.retention.abandoned_uploads import delete_abandoned_uploads
from chamfer_morph.worker.retention.deletions import Deletions
from chamfer_morph.worker.retention.job_sizes import PAGE, JobSizes
from chamfer_morph.worker.retention.steady_clock import clock_of
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.slots import janitor_id
from chamfer_morph.worker.storage import Storage, open_storage
from chamfer_morph.worker.webhooks import delivery
from chamfer_morph.worker.webhooks.webhooks import Webhooks
from morph_engine.child_process import python_command

log: logging.Logger = logging.getLogger(__name__)

ADOPTION_LIMIT_SECONDS = 70.0
"""After this an adoption is killed; it ends itself sooner, unless somebody has stopped it."""
RETENTION_SECONDS = 60.0


def adopt_in_process(executor: str) -> None:
    """Queue the jobs of a dead worker again, by a short-lived process that takes on its name."""
    subprocess.run(
        python_command("chamfer_morph.worker", "adopt", executor),
        timeout=ADOPTION_LIMIT_SECONDS, check=True,
    )  # fmt: skip


def adopt_orphans(
    settings: Settings, queue: JobQueue, adopt: Callable[[str], None] = adopt_in_process
) -> list[str]:
    """Put the jobs of dead workers back into the queue.

    A worker's lock, held meanwhile, keeps a second janitor and the worker itself away.

    Args:
        settings: Where the locks are.
        queue: The queue.
        adopt: Queues the jobs of a dead worker, whose name it is given, again.

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
            log.warning("worker %s is gone; its jobs are put back into the queue", executor)
            adopt(executor)
            dead.append(executor)
        finally:
            lock.release()
    return dead


def delete_expired(
    settings: Settings,
    queue: JobQueue,
    sizes: JobSizes,
    deletions: Deletions,
    *,
    by_age: bool = True,
) -> list[str]:
    """Delete finished jobs that are too old, and the oldest beyond the allowed space.

    Args:
        settings: What is too old and too much.
        queue: The queue.
        sizes: How much disk finished jobs fill; brought up to date here.
        deletions: Deletes them.
        by_age: Whether the clock can be believed.

    Returns:
        Ids of the deleted jobs.
    """
    deleted: list[str] = []

    def delete(job: str, why: str) -> None:
        record = queue.get(job)
        sizes.forget(job)  # one that goes on meanwhile is measured again when it has finished
        if record is not None and deletions.delete(record):
            path = f"/v1/jobs/{job}"
            service_log.log_change("expired", "deleteJob", path=path, job=job, why=why)
            deleted.append(job)

    if settings.retention_days and by_age:
        latest = (time.time() - settings.retention_days * 86400) * 1000
        after = 0, ""
        while page := queue.finished(after, PAGE):
            expired = [job for job, _, at in page if at < latest]
            for job in expired:
                delete(job, f"older than {settings.retention_days:g} days")
            if len(expired) < len(page):
                break
            after = page[-1][2], page[-1][0]
    sizes.measure_finished()
    if settings.retention_bytes:
        excess = sizes.total() - settings.retention_bytes
        while excess > 0 and (oldest := sizes.oldest(PAGE)):
            for job, size in oldest:
                if excess > 0:
                    delete(job, f"finished jobs filled more than {settings.retention_bytes} bytes")
                    excess -= size
    return deleted


def delete_old(
    settings: Settings,
    queue: JobQueue,
    storage: Storage,
    sizes: JobSizes,
    deletions: Deletions,
    webhooks: Webhooks,
    *,
    steady: bool,
) -> None:
    """Delete what nobody needs any more.

    Args:
        settings: How long and how much finished jobs are kept.
        queue: The queue.
        storage: The files.
        sizes: How much disk finished jobs fill.
        deletions: Deletes jobs.
        webhooks: Messages to webhooks.
        steady: Whether the clock can be believed; nothing is deleted for its age else.
    """
    delete_expired(settings, queue, sizes, deletions, by_age=steady)
    if steady:
        deletions.finish()
        delete_abandoned_uploads(storage)
        webhooks.forget_old()


def run(settings: Settings) -> None:
    """Do all of it for ever."""
    queue = JobQueue(settings)
    queue.migrate()
    storage = open_storage(settings, "janitor")
    engine = database(settings)
    sizes, deletions = JobSizes(engine, queue, storage), Deletions(engine, queue, storage)
    clock = clock_of(settings, sizes)
    engine = database(settings, kept=1)
    webhooks, adoptions = Webhooks(engine), Adoptions(engine)
    absent_slots = AbsentSlots(settings, engine, queue)
    delivery.start(settings)

    def adopt(executor: str) -> None:
        adopt_in_process(executor)
        adoptions.add(executor)

    next_deletion = 0.0
    while True:
        liveness.get_on(settings, janitor_id())
        try:
            adopt_orphans(settings, queue, adopt)
            if time.monotonic() > next_deletion:
                steady = clock.is_steady()
                if not steady:
                    log.warning(
                        "the clock has jumped; nothing will be deleted for its age for a day"
                    )
                delete_old(settings, queue, storage, sizes, deletions, webhooks, steady=steady)
                absent_slots.forget()
                next_deletion = time.monotonic() + RETENTION_SECONDS
        except Exception:  # the database is away, or an adoption failed: try again
            log.exception("the janitor failed and will try again")
        time.sleep(settings.adoption_seconds)
