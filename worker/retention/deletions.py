"""Jobs whose files go after their rows: what breaks off in between is done later.

A note of it is in the database before the row goes. So no folder is ever taken for one that
nobody needs only because a database does not know of it, which may be the wrong one.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import sqlalchemy as sa

from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.storage import Storage, StoreUnavailableError
from chamfer_morph.worker.tables import create_missing

ABANDONED_SECONDS = 3600.0
"""Who has not ended a deletion for so long has died."""

_TABLE = sa.Table(
    "morph_deletions",
    sa.MetaData(),
    sa.Column("job", sa.String(26), primary_key=True),
    sa.Column("begun_at", sa.BigInteger, nullable=False),
)
"""When a deletion began in milliseconds since 1970."""


class Deletions:
    """Deletions of jobs with their files. Calls block.

    Args:
        engine: The database of the queue.
        queue: The queue.
        storage: The files.
    """

    def __init__(self, engine: sa.Engine, queue: JobQueue, storage: Storage) -> None:
        self._engine = engine
        self._queue = queue
        self._storage = storage
        create_missing(engine, _TABLE)

    def delete(self, job: JobRecord) -> bool:
        """Forget a finished job and delete its files.

        Where the object store is away, `finish` deletes them.

        Returns:
            False if somebody has resumed, retried or deleted it since its record was read.
        """
        with suppress(StoreUnavailableError), self.noted(job.id):
            if not self._queue.delete_finished(job):
                return False
            self._storage.remove_job(job.id)
        return True

    @contextmanager
    def noted(self, job: str) -> Iterator[None]:
        """Let the files of a job go later if it has no row and the body breaks off."""
        row = {"job": job, "begun_at": round(time.time() * 1000)}
        with suppress(sa.exc.IntegrityError), self._engine.begin() as connection:  # noted just now
            connection.execute(sa.delete(_TABLE).where(_TABLE.c.job == job))
            connection.execute(sa.insert(_TABLE).values(row))
        yield
        self._forget(job)

    def finish(self, abandoned_seconds: float = ABANDONED_SECONDS) -> list[str]:
        """Delete the files of jobs whose deletion has broken off so long ago [s].

        Returns:
            Ids of these jobs.
        """
        latest = round((time.time() - abandoned_seconds) * 1000)
        with self._engine.connect() as connection:
            query = sa.select(_TABLE.c.job).where(_TABLE.c.begun_at <= latest)
            jobs = connection.execute(query).scalars().all()
        known = self._queue.states(jobs)
        deleted = []
        for job in jobs:
            if job not in known:
                self._storage.remove_job(job)
                deleted.append(job)
            self._forget(job)
        return deleted

    def _forget(self, job: str) -> None:
        with self._engine.begin() as connection:
            connection.execute(sa.delete(_TABLE).where(_TABLE.c.job == job))
