"""How much disk finished jobs fill, in a table: summed up by a query, not by a walk over folders.

The janitor measures a job once it has finished, and whoever adds to its files or deletes them
measures it again. Jobs that are not finished, and those that the janitor has not come to yet, are
measured where they are asked for.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import sqlalchemy as sa

from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.storage import Storage
from chamfer_morph.worker.tables import create_missing

PAGE = 1000
"""Jobs measured at once."""

_TABLE = sa.Table(
    "morph_job_sizes",
    sa.MetaData(),
    sa.Column("job", sa.String(26), primary_key=True),
    sa.Column("owner", sa.String(64), nullable=False),
    sa.Column("finished_at", sa.BigInteger, nullable=False),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Index("morph_job_sizes_by_owner", "owner", "bytes"),
    sa.Index("morph_job_sizes_by_age", "finished_at"),
)
"""When a job finished in milliseconds since 1970."""


class JobSizes:
    """The table. Calls block.

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

    def measure_finished(self) -> None:
        """Measure the finished jobs that are not in the table, page by page."""
        while page := self._queue.finished_unless_in(_TABLE.c.job, PAGE):
            sizes = [(*job, self._storage.job_bytes(job[0])) for job in page]
            with self._queue.holding_finished(page) as (connection, unchanged):
                rows = [
                    {"job": job, "owner": owner, "finished_at": at, "bytes": size}
                    for job, owner, at, size in sizes
                    if job in unchanged  # not deleted, or begun again, as it was measured
                ]
                ids = [row["job"] for row in rows]
                connection.execute(sa.delete(_TABLE).where(_TABLE.c.job.in_(ids)))
                if rows:
                    connection.execute(sa.insert(_TABLE), rows)

    def measure(self, job: str) -> None:
        """Measure a job again whose files have changed, if it is in the table."""
        size = self._storage.job_bytes(job)
        with self._engine.begin() as connection:
            connection.execute(sa.update(_TABLE).where(_TABLE.c.job == job).values(bytes=size))

    def forget(self, job: str) -> None:
        """Forget a job that is deleted, or goes on."""
        with self._engine.begin() as connection:
            connection.execute(sa.delete(_TABLE).where(_TABLE.c.job == job))

    def of(self, owner: str) -> int:
        """Disk that an owner's jobs fill, with what unfinished ones are expected to [bytes]."""
        now = round(time.time() * 1000)
        after = self._newest(_TABLE.c.finished_at <= now)  # by a clock that is not ahead
        measured = sa.select(_TABLE.c.job).where(
            _TABLE.c.owner == owner, _TABLE.c.finished_at > after
        )
        with self._engine.connect() as connection:
            known = {job for (job,) in connection.execute(measured)}
        left = set(self._queue.unmeasured(owner, after)) - known
        expected = self._queue.expected_bytes(owner)
        unmeasured = (max(self._storage.job_bytes(job), expected.get(job, 0)) for job in left)
        return self._sum(_TABLE.c.owner == owner) + sum(unmeasured)

    def total(self) -> int:
        """Disk that all measured jobs fill [bytes]."""
        return self._sum()

    def oldest(self, limit: int) -> Sequence[tuple[str, int]]:
        """Id and size [bytes] of the jobs that have finished first."""
        query = sa.select(_TABLE.c.job, _TABLE.c.bytes).order_by(_TABLE.c.finished_at)
        with self._engine.connect() as connection:
            return [(job, size) for job, size in connection.execute(query.limit(limit))]

    def newest(self) -> float | None:
        """When the job finished that was measured last, if there is one [s since 1970]."""
        return self._newest() / 1000 or None

    def _sum(self, *conditions: sa.ColumnElement[bool]) -> int:
        query = sa.select(sa.func.coalesce(sa.func.sum(_TABLE.c.bytes), 0)).where(*conditions)
        with self._engine.connect() as connection:
            return int(connection.execute(query).scalar_one())

    def _newest(self, *conditions: sa.ColumnElement[bool]) -> int:
        """When the job finished that was measured last [ms since 1970]."""
        last = sa.func.coalesce(sa.func.max(_TABLE.c.finished_at), 0)
        query = sa.select(last).where(*conditions)
        with self._engine.connect() as connection:
            return int(connection.execute(query).scalar_one())
