"""The queue as the API sees it: jobs in, their state out.

A job is a DBOS workflow. Its status, input, result and error live in the workflow's row and nowhere
else; owner, name and the like are attributes of that row.

Owners take turns (start-time fair queuing, Goyal et al. 1996): a job's place in the queue is one
more than that of its owner's last job, or than that of the job started last, whichever is larger.
Of jobs that are queued at the same moment and so have the same place, all but one move on.
DBOS starts jobs in the order of these places, which it calls priority. An owner's own priorities
decide which of their jobs takes which of their places.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cached_property
from typing import Any

import sqlalchemy as sa
from dbos import (
    DBOSClient,
    PortableWorkflowError,
    WorkflowSerializationFormat,
    WorkflowStatus,
)
from dbos import error as dbos_error
from pydantic import BaseModel, Field, Json

from chamfer_morph.schemas import JobState, Outcome, Problem
from chamfer_morph.schemas.jobs import JobPlacement
from chamfer_morph.worker import job_trace
from chamfer_morph.worker.alarm import CHANNEL
from chamfer_morph.worker.dbos_adapter import SERIALIZER, WorkflowTable, database, migrate
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_state import job_state, statuses
from chamfer_morph.worker.own_queue import (
    ENQUEUED,
    NOBODY,
    PAUSED_QUEUE,
    PENDING,
    QUEUE,
    WORKFLOW,
    OwnQueue,
)
from chamfer_morph.worker.places import next_place
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import StoreUnavailableError, open_storage
from chamfer_morph.worker.webhooks.job_changes import create_triggers
from chamfer_morph.worker.webhooks.webhooks import Webhooks

APPLICATION = "morph"
APPLICATION_VERSION = "1"
RECORD_CACHE_SIZE = 4096
"""Jobs that a process remembers as it read them last."""

PAGE = 1000
"""Jobs read at once."""

UNREADABLE = Problem(
    cause="What the job has reported cannot be read.",
    remedy="Resume it: its finished frames are reported again.",
    kind="internal",
)

log: logging.Logger = logging.getLogger(__name__)


class JobChangedError(Exception):
    """A job has been started, stopped or deleted since somebody looked at it."""


@dataclass(frozen=True, eq=False)
class JobRecord:
    """A job as the queue knows it; the same object as long as its row stays as it is.

    Attributes:
        id: Its id.
        owner: Name of the key that submitted it; empty without keys.
        state: Where it stands.
        spec: What to compute.
        name: The user's name for it.
        sweep: The sweep it belongs to, if any.
        priority: Smaller runs earlier among the owner's jobs.
        paused: Whether it waits until its owner ends a pause.
        estimate: What it was expected to take [s].
        via_names: Names of the shapes between its source and its target.
        placement: Where it puts its shapes; None for one that an older version has queued.
        reused_from: The job whose result it was given, if any.
        attributes: Everything that was attached to it.
        created_at, started_at, finished_at: Times in UTC, None while still to come.
        executor: The worker slot that runs it or ran it last.
        outcome: What it left, once it has succeeded.
        problem: Why it failed or timed out.
    """

    id: str
    owner: str
    state: JobState
    spec: JobSpec
    name: str
    sweep: str | None
    priority: int
    paused: bool
    estimate: float
    via_names: list[str]
    placement: JobPlacement | None
    reused_from: str | None
    attributes: dict[str, Any]
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    executor: str | None
    outcome: Outcome | None
    problem: Problem | None

    @property
    def age_and_id(self) -> tuple[int, str]:
        """Its place in a listing: when it was created [ms since 1970], and its id."""
        return round(self.created_at.timestamp() * 1000), self.id


class _Attributes(BaseModel):
    """What is attached to a job and has to be of a type; whoever reads the row relies on it."""

    owner: str = ""
    name: str = ""
    sweep: str | None = None
    priority: int = 0
    estimate: float = Field(0, allow_inf_nan=False)
    via_names: Json[list[str]] = []
    placement: Json[JobPlacement] | None = None
    reused_from: str | None = None


class JobQueue:
    """The queue, without the means to run a job. Calls block; any thread may make them."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._storage = open_storage(settings, "queue")
        self._engine = database(settings)
        self._client = DBOSClient(
            system_database_url=settings.system_database_url,
            system_database_engine=self._engine,
            application_name=APPLICATION,
            serializer=SERIALIZER,
            lazy=True,
        )
        self._workflows = WorkflowTable(self._client, settings)
        self._rows = self._workflows.rows
        self._own = OwnQueue(self._workflows)
        self._cache: dict[str, tuple[list[Any], JobRecord | None]] = {}

    def migrate(self) -> None:
        """Create or upgrade the tables and the queue; harmless to repeat."""
        migrate(self._settings)
        self._workflows.create_indexes()
        self._own.create_table()
        Webhooks.create_tables(self._engine)
        with self._workflows.begin() as connection:
            create_triggers(connection, self._workflows.name)
        self._client.register_queue(
            QUEUE,
            worker_concurrency=1,
            polling_interval_sec=self._settings.queue_poll_seconds,
        )

    def enqueue(
        self,
        spec: JobSpec,
        *,
        job_id: str,
        owner: str,
        priority: int = 100,
        attributes: Mapping[str, str | int | float] | None = None,
        delay_seconds: float | None = None,
    ) -> bool:
        """Put a job into the queue.

        Args:
            spec: What to compute.
            job_id: Its id; submitting the same id again changes nothing.
            owner: Name of the submitting key; slots are shared out evenly between owners.
            priority: 1 to 1000; smaller runs earlier among the owner's jobs.
            attributes: More to attach: `name`, `method`, `sweep` and what else is to be shown.
            delay_seconds: Start it after so long at the earliest, unless `finish` comes before [s].

        Returns:
            False if the id is taken.
        """
        queue = self._own.queue_of(owner or NOBODY)
        delay = {} if delay_seconds is None else {"delay_seconds": delay_seconds}
        try:
            self._client.enqueue(
                {
                    **delay,  # type: ignore[typeddict-item]
                    "workflow_name": WORKFLOW,
                    "queue_name": queue,
                    "workflow_id": job_id,
                    "workflow_id_reuse_policy": "reject",
                    "app_version": APPLICATION_VERSION,
                    "workflow_timeout": spec.timeout_seconds,
                    "priority": self._next_place(owner),
                    "authenticated_user": owner or NOBODY,
                    "serialization_type": WorkflowSerializationFormat.PORTABLE,
                    "attributes": {
                        "owner": owner,
                        "priority": priority,
                        **(attributes or {}),
                        **job_trace.of_submission(),
                    },
                },
                spec.model_dump(mode="json"),
            )
        except dbos_error.DBOSWorkflowIDInUseError:
            return False
        self._settle(owner, queue)
        self._own.order_newest(owner or NOBODY, job_id, priority)
        self.wake_workers()
        return True

    def finish(self, job_id: str, outcome: Outcome, attributes: Mapping[str, str]) -> bool:
        """Let a job that waits for its delay succeed; False if it waits no more.

        Args:
            job_id: The job.
            outcome: What it has left.
            attributes: More to attach.
        """
        c, now = self._table.c, round(time.time() * 1000)
        done = {"status": "SUCCESS", "started_at_epoch_ms": now, "completed_at": now}
        waiting = (c.workflow_uuid == job_id) & (c.status == "DELAYED")
        output = SERIALIZER.serialize(outcome.model_dump(mode="json"))
        with self._workflows.begin() as connection:
            query = sa.select(c.attributes).where(waiting).with_for_update()
            found = connection.execute(query).one_or_none()
            if found is None:
                return False
            done |= {"updated_at": now, "attributes": {**(found[0] or {}), **attributes}}
            connection.execute(sa.update(self._table).where(waiting).values(done))
            row = {"workflow_uuid": job_id, "output": output}
            connection.execute(sa.insert(self._workflows.outcomes).values(row))
        return True

    def wake_workers(self) -> None:
        """Tell idle workers that there may be a job; without, they look from time to time."""
        try:
            self._workflows.notify(CHANNEL)
        except sa.exc.DBAPIError:  # what is queued is queued
            log.warning("idle workers could not be notified of a job", exc_info=True)

    def is_paused(self, owner: str) -> bool:
        """Whether no more jobs of an owner are started."""
        return self._own.is_paused(owner or NOBODY)

    def pause(self, owner: str) -> None:
        """Start no more jobs of an owner, until `unpause`; those that run go on."""
        self._own.pause(owner or NOBODY)

    def unpause(self, owner: str) -> None:
        """Start jobs of an owner again; they take places as if they were queued now."""
        self._own.unpause(owner or NOBODY, self._next_place(owner))
        self.wake_workers()

    def put_first(self, job_id: str) -> None:
        """Start a queued job before all others of its owner.

        Raises:
            JobChangedError: It is not queued, or not there, any more.
        """
        job = self.get(job_id)
        if job is None or not self._own.put_first(job.owner or NOBODY, job_id):
            raise JobChangedError("The job is no longer queued.")

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
        return _time(self._rows(query)[0][0])

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
            (job, int(at), "timeout" if status == "CANCELLED" else _kind_of(error))
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

    def cancel(self, job_id: str) -> None:
        """Stop a job; a running one ends within two seconds and keeps its frames."""
        self._client.cancel_workflow(job_id)

    def resume(self, job_id: str) -> None:
        """Queue a finished job again; it goes on from its last frame.

        Raises:
            JobChangedError: It is not finished, or not there, any more.
        """
        job = self.get(job_id)
        if job is None or not job.state.finished:  # the mark of a retry in the queue stays
            raise JobChangedError("The job is not finished.")
        self._storage.unmark(job_id)
        self._rewind(job_id)

    def retry(self, job_id: str) -> None:
        """Queue a finished job again, from the beginning.

        What it left is deleted once it is in the queue: a failure at any instant leaves it finished
        with its result, or queued.

        Raises:
            JobChangedError: It is not finished, or not there, any more.
        """
        try:
            mark = self._storage.mark_for_discard(job_id)
        except (FileExistsError, FileNotFoundError) as error:  # its folder goes at this moment
            raise JobChangedError("The job is being deleted.") from error
        try:
            self._rewind(job_id)
        except JobChangedError:
            self._storage.unmark(job_id, mark)
            raise
        with suppress(OSError, StoreUnavailableError):  # its worker does it, else
            self._storage.discard_if_marked(job_id, wait_seconds=0)

    def delete_finished(self, job: JobRecord) -> bool:
        """Forget a job that is finished as when its record was read; False if it has changed."""
        c = self._table.c
        ended, at = sa.cast(c.completed_at, sa.BigInteger), job.finished_at
        states = sorted({status for s in JobState if s.finished for status in statuses(s)})
        unchanged = ended == round(at.timestamp() * 1000) if at else ended.is_(None)
        deleted = self._workflows.delete(job.id, c.status.in_(states) & unchanged)
        if deleted:
            self._cache.pop(job.id, None)
        return deleted

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

    def ping(self) -> None:
        """Ask the database for an answer; raises if it has none."""
        with self._engine.connect() as connection:
            connection.execute(sa.text("select 1"))

    def close(self) -> None:
        """Give the connections back."""
        self._client.destroy()
        self._workflows.close()
        self._engine.dispose()

    def _rewind(self, job_id: str) -> None:
        job = self.get(job_id)
        owner = job.owner if job else ""
        queue = self._own.queue_of(owner or NOBODY)
        self._own.move_finished(job_id, self._next_place(owner))  # its old one would be unfair
        if again := job_trace.of_next_run():
            self._client.update_workflow_attributes(job_id, again, merge=True)
        try:
            self._client.rewind_workflow(
                job_id, application_version=APPLICATION_VERSION, queue_name=queue
            )
        except dbos_error.DBOSException as error:
            raise JobChangedError(str(error)) from error
        self._settle(owner, queue)
        self._own.order_newest(owner or NOBODY, job_id, job.priority if job else 0)
        self.wake_workers()

    def _settle(self, owner: str, queue: str) -> None:
        """See that a job that was just queued waits where its owner's jobs do by now."""
        if self._own.queue_of(owner or NOBODY) != queue:
            self._own.settle(owner or NOBODY)

    def _next_place(self, owner: str) -> int:
        """Place in the queue of the next job of an owner."""
        c = self._table.c
        queued, running = c.status == ENQUEUED, c.status == PENDING
        last = self._select(sa.func.max(c.priority)).where(self._in_flight)
        query = sa.select(
            last.where(self._and_owned_by(owner)).scalar_subquery(),
            last.where(running).scalar_subquery(),
            self._select(sa.func.min(c.priority)).where(self._in_flight, queued).scalar_subquery(),
        )
        return next_place(*self._rows(query)[0])

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
            for status in self._client.list_workflows(workflow_ids=changed, name=WORKFLOW):
                version = [status.status, status.executor_id, status.updated_at, status.queue_name]
                cache[status.workflow_id] = version, _record_or_none(status)
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


def _record_or_none(status: WorkflowStatus) -> JobRecord | None:
    """A job, or None where its row cannot be read; one such row must not hide the others."""
    try:
        return _record(status)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError):
        log.warning("the row of job %s cannot be read", status.workflow_id, exc_info=True)
        return None


def _record(status: WorkflowStatus) -> JobRecord:
    attributes = status.attributes or {}
    known = _Attributes.model_validate(attributes)
    arguments = (status.input or {"args": ()})["args"]
    deadline, ended = status.workflow_deadline_epoch_ms, status.completed_at
    late = deadline is not None and ended is not None and ended >= deadline
    state = job_state(status.status, late=late)
    spec = JobSpec.model_validate(arguments[0])
    try:
        outcome = Outcome.model_validate(status.output) if state is JobState.SUCCEEDED else None
        problem = _problem(state, status.error, spec)
    except ValueError:  # pydantic's
        state, outcome, problem = JobState.FAILED, None, UNREADABLE
    return JobRecord(
        id=status.workflow_id,
        owner=known.owner,
        state=state,
        spec=spec,
        name=known.name,
        sweep=known.sweep,
        priority=known.priority,
        paused=state is JobState.QUEUED and status.queue_name == PAUSED_QUEUE,
        estimate=known.estimate,
        via_names=known.via_names,
        placement=known.placement,
        reused_from=known.reused_from,
        attributes=attributes,
        created_at=_time(status.created_at) or datetime.now(timezone.utc),
        started_at=_time(status.dequeued_at),
        finished_at=_time(status.completed_at) if state.finished else None,
        executor=status.executor_id if status.dequeued_at else None,
        outcome=outcome,
        problem=problem,
    )


def _problem(state: JobState, error: Exception | None, spec: JobSpec) -> Problem | None:
    if state is JobState.TIMED_OUT:
        return Problem(
            cause=f"The job ran longer than its time limit of {spec.timeout_seconds:g} s.",
            remedy="Resume it; it continues from its last frame.",
            kind="timeout",
        )
    if state is not JobState.FAILED:
        return None
    if isinstance(error, PortableWorkflowError) and isinstance(error.data, dict):
        return Problem.model_validate(error.data)
    cause = str(error) if error else "Its worker died repeatedly."
    return Problem(
        cause=cause, remedy="Retry it; if it fails again, read its log.", kind="internal"
    )


def _kind_of(error: str | None) -> str:
    """The kind of the problem in the column `error`, without reading all of the job."""
    with suppress(TypeError, ValueError, LookupError):
        return str(json.loads(error or "")["data"]["kind"])
    return "internal"


def _time(milliseconds: int | None) -> datetime | None:
    if milliseconds is None:
        return None
    return datetime.fromtimestamp(int(milliseconds) / 1000, timezone.utc)
