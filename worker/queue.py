"""The queue as the API sees it: jobs in, and what may be done with them.

A job is a DBOS workflow. Its status, input, result and error live in the workflow's row and nowhere
else; owner, name and the like are attributes of that row.

Owners take turns (start-time fair queuing, Goyal et al. 1996): a job's place in the queue is one
more than that of its owner's last job, or than that of the job started last, whichever is larger.
Of jobs that are queued at the same moment and so have the same place, all but one move on.
DBOS starts jobs in the order of these places, which it calls priority. An owner's own priorities
decide which of their jobs takes which of their places.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from contextlib import suppress

import sqlalchemy as sa
from dbos import (
    DBOSClient,
    WorkflowSerializationFormat,
)
from dbos import error as dbos_error

from chamfer_morph.schemas import JobState, Outcome
from chamfer_morph.worker import job_trace, start_times
from chamfer_morph.worker.alarm import CHANNEL
from chamfer_morph.worker.dbos_adapter import SERIALIZER, WorkflowTable, database, migrate
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_listing import JobListing
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.job_state import statuses
from chamfer_morph.worker.own_queue import (
    ENQUEUED,
    NOBODY,
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

log: logging.Logger = logging.getLogger(__name__)


class JobChangedError(Exception):
    """A job has been started, stopped or deleted since somebody looked at it."""


class JobQueue(JobListing):
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
        super().__init__(WorkflowTable(self._client, settings))
        self._own = OwnQueue(self._workflows)

    def migrate(self) -> None:
        """Create or upgrade the tables and the queue; harmless to repeat."""
        migrate(self._settings)
        self._workflows.create_indexes()
        self._own.create_table()
        Webhooks.create_tables(self._engine)
        with self._workflows.begin() as connection:
            create_triggers(connection, self._workflows.name)
            start_times.create_trigger(connection, self._workflows.name)
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
