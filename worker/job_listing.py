"""What is asked of the queue: jobs by owner, state, sweep and age, and figures of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from functools import cached_property
from typing import Any

import sqlalchemy as sa

from chamfer_morph.schemas import JobState
from chamfer_morph.worker.dbos_adapter import WorkflowTable
from chamfer_morph.worker.job_record import JobRecord, kind_of, record_or_none, utc_time
from chamfer_morph.worker.job_state import job_state, statuses
from chamfer_morph.worker.own_queue import (
    ENQUEUED,
    NOBODY,
    PAUSED_QUEUE,
    PENDING,
    QUEUE,
    WORKFLOW,
)

DISK_BYTES = "disk_bytes"
"""Attribute of a job: the disk that it is expected to fill [bytes]."""

RECORD_CACHE_SIZE = 4096
"""Jobs that a process remembers as it last read them."""

PAGE = 1000
"""Jobs read at once."""


class JobListing:
    """The jobs of the queue, to be read. Calls block; any thread may make them.

    Args:
        workflows: Their rows.
    """

    def __init__(self, workflows: WorkflowTable) -> None:
        self._workflows = workflows
        self._cache: dict[str, tuple[list[Any], JobRecord | None]] = {}

    def get(self, job_id: str) -> JobRecord | None:
        """A job, or None where there is none of that id, or its row cannot be read."""
        rows = self._rows(self._version, {"job": job_id})
        return next(iter(self._records(rows)), None)

    def newest(
        self,
        *,
        owner: str | None = None,
        states: Collection[JobState] | None = None,
        sweep: str | None = None,
        method: str | None = None,
        before: tuple[int, str] | None = None,
        limit: int = 100,
    ) -> list[JobRecord]:
        """Jobs, the newest first, without those whose row cannot be read.

        Args:
            owner: Only jobs of this key; None for all.
            states: Only jobs in these states.
            sweep: Only jobs of this sweep.
            method: Only jobs of this method.
            before: Only jobs older than the one with this `age_and_id`.
            limit: At most so many.
        """
        c = self._table.c
        created = sa.cast(c.created_at, sa.BigInteger)  # SQLite may store fractions
        query = self._versions.add_columns(created)
        if owner is not None:
            few = sweep is not None
            query = query.where(self._and_owned_by(owner) if few else self._owned_by(owner))
        if sweep is not None:
            query = query.where(self._workflows.attribute("sweep") == sweep)
        if method is not None:
            query = query.where(self._workflows.attribute("method") == method)
        if states:
            wanted = sorted({status for state in states for status in statuses(state)})
            query = query.where(c.status.in_(wanted))
            if JobState.TIMED_OUT not in states:
                query = query.where((c.status != "CANCELLED") | ~self._late)
            if JobState.CANCELLED not in states:
                query = query.where((c.status != "CANCELLED") | self._late)
        query = query.order_by(created.desc(), c.workflow_uuid.desc())
        records: list[JobRecord] = []
        while room := limit - len(records):
            older = query
            if before is not None:
                older = query.where(sa.tuple_(created, c.workflow_uuid) < before)
            rows = self._rows(older.limit(room))
            records += self._records([row[:-1] for row in rows])
            if len(rows) < room:
                break
            before = rows[-1][-1], rows[-1][0]
        return records

    def all(
        self, *, owner: str | None = None, states: Collection[JobState] | None = None
    ) -> Iterator[JobRecord]:
        """All jobs, the newest first, read page by page; arguments as of `newest`."""
        before: tuple[int, str] | None = None
        while page := self.newest(owner=owner, states=states, before=before, limit=PAGE):
            yield from page
            before = page[-1].age_and_id

    def states(self, job_ids: Collection[str]) -> dict[str, JobState]:
        """The states of some jobs, without those that do not exist; cheaper than `get`."""
        c = self._table.c
        query = self._select(c.workflow_uuid, c.status, self._late)
        rows = self._rows(query.where(c.workflow_uuid.in_(list(job_ids))))
        return {job_id: job_state(status, late=bool(late)) for job_id, status, late in rows}

    def counts(self, owner: str | None = None) -> dict[JobState, int]:
        """Number of jobs in each state."""
        c = self._table.c
        query = self._select(c.status, self._late, sa.func.count())
        if owner is not None:
            query = query.where(self._owned_by(owner))
        counts = dict.fromkeys(JobState, 0)
        for status, late, count in self._rows(query.group_by(c.status, self._late)):
            counts[job_state(status, late=bool(late))] += count
        return counts

    def waiting_since(self) -> datetime | None:
        """When the job that waits longest came into the queue; None where none waits."""
        c = self._table.c
        query = self._select(sa.func.min(c.updated_at)).where(self._in_flight, c.status == ENQUEUED)
        return utc_time(self._rows(query)[0][0])

    def unfinished(self, owner: str) -> int:
        """Number of jobs of an owner that are queued or running."""
        query = self._select(sa.func.count()).where(self._unfinished, self._and_owned_by(owner))
        return int(self._rows(query)[0][0])

    def finished(self, after: tuple[int, str], limit: int) -> list[tuple[str, str, int]]:
        """Finished jobs, the longest finished first: id, owner, and when [ms since 1970].

        Args:
            after: Only those that finished after this time, or then and have a larger id.
            limit: At most so many.
        """
        c = self._table.c
        at = c.completed_at
        query = self._select(c.workflow_uuid, c.authenticated_user, at).where(
            (at > after[0]) | ((at == after[0]) & (c.workflow_uuid > after[1])),
            at >= after[0],  # for the index
        )
        return self._finished(query.order_by(at, c.workflow_uuid).limit(limit))

    def finished_unless_in(self, jobs: sa.Column[str], limit: int) -> list[tuple[str, str, int]]:
        """Finished jobs whose ids another table has not in this column: as of `finished`."""
        c = self._table.c
        query = self._select(c.workflow_uuid, c.authenticated_user, c.completed_at).where(
            c.completed_at > 0, ~sa.exists().where(jobs == c.workflow_uuid)
        )
        return self._finished(query.limit(limit))

    def _finished(self, query: sa.Select[Any]) -> list[tuple[str, str, int]]:
        rows = self._rows(query)
        return [(job, "" if owner == NOBODY else owner, int(at)) for job, owner, at in rows]

    def failed(self, after: tuple[int, str], limit: int) -> list[tuple[str, int, str]]:
        """Failed and timed out jobs, the longest finished first: id, when, and kind of problem.

        Arguments are those of `finished`.
        """
        c = self._table.c
        at = c.completed_at
        ended = sorted({*statuses(JobState.FAILED), *statuses(JobState.TIMED_OUT)})
        outcomes = self._workflows.outcomes
        found = self._table.outerjoin(outcomes, c.workflow_uuid == outcomes.c.workflow_uuid)
        columns = self._select(c.workflow_uuid, at, c.status, outcomes.c.error).select_from(found)
        query = columns.where(
            (at > after[0]) | ((at == after[0]) & (c.workflow_uuid > after[1])),
            at >= after[0],  # for the index
            c.status.in_(ended),
            (c.status != "CANCELLED") | self._late,
        )
        rows = self._rows(query.order_by(at, c.workflow_uuid).limit(limit))
        return [
            (job, int(at), "timeout" if status == "CANCELLED" else kind_of(error))
            for job, at, status, error in rows
        ]

    def succeeded(self, owner: str, run: str, limit: int = 10) -> list[JobRecord]:
        """An owner's jobs that have succeeded with this attribute `run`, the newest first."""
        c, of_run = self._table.c, self._workflows.attribute("run") == run
        query = self._versions.where(of_run, self._and_owned_by(owner), c.status == "SUCCESS")
        return self._records(self._rows(query.order_by(c.created_at.desc()).limit(limit)))

    def unmeasured(self, owner: str, after: int) -> list[str]:
        """Ids of an owner's jobs that are not finished, or have finished after a time [ms]."""
        c, mine = self._table.c, self._and_owned_by(owner)
        queries = (
            self._select(c.workflow_uuid).where(self._unfinished, mine),
            self._select(c.workflow_uuid).where(c.completed_at > after, mine),
        )
        return [job for query in queries for (job,) in self._rows(query)]

    def expected_bytes(self, owner: str) -> dict[str, int]:
        """What an owner's unfinished jobs are expected to fill, by their ids [bytes]."""
        needed = sa.cast(self._workflows.attribute(DISK_BYTES), sa.BigInteger)
        query = self._select(self._table.c.workflow_uuid, sa.func.coalesce(needed, 0))
        rows = self._rows(query.where(self._unfinished, self._and_owned_by(owner)))
        return {job: int(size) for job, size in rows}

    @contextmanager
    def holding_finished(
        self, jobs: Collection[tuple[str, str, int]]
    ) -> Iterator[tuple[sa.Connection, set[str]]]:
        """A transaction, and the ids of those of some jobs that are still finished as they were.

        These stay so to its end. Jobs are as `finished` returns them.
        """
        c, ids = self._table.c, [job for job, *_ in jobs]
        query = sa.select(c.workflow_uuid, c.completed_at).where(c.workflow_uuid.in_(ids))
        with self._workflows.begin() as connection:
            rows = connection.execute(query.with_for_update(read=True))
            found = {(job, int(at)) for job, at in rows if at is not None}
            yield connection, {job for job, _, at in jobs if (job, at) in found}

    def position(self, job_id: str) -> int | None:
        """Jobs that start before a queued one; None if it is not queued, or paused."""
        c = self._table.c
        waiting = c.status == ENQUEUED
        query = self._select(c.priority, c.created_at).where(
            self._in_flight, waiting, c.workflow_uuid == job_id
        )
        found = self._rows(query)
        if not found:
            return None
        place, created = found[0]
        earlier = (c.priority < place) | ((c.priority == place) & (c.created_at < created))
        return int(
            self._rows(self._select(sa.func.count()).where(self._in_flight, waiting, earlier))[0][0]
        )

    def running(self) -> dict[str, set[str]]:
        """Ids of the running jobs by the worker slot that holds them."""
        c = self._table.c
        query = self._select(c.executor_id, c.workflow_uuid).where(
            self._in_flight, c.status == PENDING
        )
        jobs: dict[str, set[str]] = {}
        for executor, job_id in self._rows(query):
            jobs.setdefault(executor, set()).add(job_id)
        return jobs

    @cached_property
    def _version(self) -> sa.Select[Any]:
        """The query for one job, `job`."""
        return self._versions.where(self._table.c.workflow_uuid == sa.bindparam("job"))

    @cached_property
    def _versions(self) -> sa.Select[Any]:
        """A query for jobs: their ids, and what changes with every change of their row."""
        c = self._table.c
        return self._select(c.workflow_uuid, c.status, c.executor_id, c.updated_at, c.queue_name)

    def _records(self, rows: Sequence[Sequence[Any]]) -> list[JobRecord]:
        """The jobs of rows of `_versions`; those that have not changed are not read again."""
        if len(self._cache) > RECORD_CACHE_SIZE:
            self._cache = {}
        cache = self._cache
        changed = [id_ for id_, *v in rows if id_ not in cache or cache[id_][0] != v]
        if changed:
            for status in self._workflows.read(changed, WORKFLOW):
                version = [status.status, status.executor_id, status.updated_at, status.queue_name]
                cache[status.workflow_id] = version, record_or_none(status)
        found = (cache[job_id][1] for job_id, *_ in rows if job_id in cache)
        return [record for record in found if record is not None]

    @property
    def _table(self) -> sa.Table:
        return self._workflows.table

    def _select(self, *columns: Any) -> sa.Select[Any]:
        """A query for columns of the jobs."""
        return sa.select(*columns).where(self._table.c.name == WORKFLOW)

    @property
    def _in_flight(self) -> sa.ColumnElement[bool]:
        """Whether a job is queued or running, in the words of DBOS's index of these."""
        c = self._table.c
        return (c.queue_name == QUEUE) & c.status.in_([ENQUEUED, PENDING])

    @property
    def _unfinished(self) -> sa.ColumnElement[bool]:
        """The same with the jobs of owners who have paused."""
        c = self._table.c
        return c.queue_name.in_([QUEUE, PAUSED_QUEUE]) & c.status.in_([ENQUEUED, PENDING])

    def _owned_by(self, owner: str) -> sa.ColumnElement[bool]:
        return self._table.c.authenticated_user == (owner or NOBODY)

    def _and_owned_by(self, owner: str) -> sa.ColumnElement[bool]:
        """The same where few jobs are left by other conditions: no reason to read by owner."""
        return sa.func.coalesce(self._table.c.authenticated_user, NOBODY) == (owner or NOBODY)

    @property
    def _late(self) -> sa.ColumnElement[bool]:
        """Whether a workflow ended after its deadline."""
        c = self._table.c
        return sa.func.coalesce(c.completed_at >= c.workflow_deadline_epoch_ms, sa.false())

    def _rows(self, query: Any, values: Mapping[str, Any] | None = None) -> Sequence[Any]:
        return self._workflows.rows(query, values)
