"""The database that DBOS keeps workflows in, and its one table that we read and write ourselves.

DBOS has no public interface to that table. Nothing else here depends on what DBOS may change.
"""

from __future__ import annotations

import logging
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from importlib import metadata
from typing import Any

import psycopg
import sqlalchemy as sa
from dbos import DBOS, DBOSClient, DBOSPortableJSONSerializer, WorkflowStatus
from dbos import _dbos as dbos_main
from dbos import _queue as dbos_queue
from dbos._serialization import DefaultSerializer
from dbos._utils import retriable_postgres_exception, retriable_sqlite_exception

from chamfer_morph.worker.alarm import Alarm
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.postgres_timeouts import TIMEOUTS, session_options
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.tables import create_missing
from morph_engine.errors import MorphError

log: logging.Logger = logging.getLogger(__name__)

CONNECTIONS = 10
"""Connections to the database that a process keeps open; opening one costs more than a query."""

COLUMNS = frozenset(
    {
        "workflow_uuid", "name", "status", "authenticated_user", "attributes", "priority",
        "executor_id", "created_at", "updated_at", "completed_at", "workflow_deadline_epoch_ms",
        "queue_name", "started_at_epoch_ms",
    }
)  # fmt: skip
"""What the queue uses of the table."""

OUTCOME_COLUMNS = frozenset({"workflow_uuid", "output", "error"})
"""What it uses of the table of their outcomes."""

PAYLOADS = ("workflow_input", "workflow_output", "operation_outputs")
"""Tables with rows of a workflow that do not go with its own row by themselves."""

REST_SECONDS = 30.0

CONTENTION = (psycopg.errors.LockNotAvailable, psycopg.errors.SerializationFailure)
"""What workers that claim jobs at the same time do to each other."""

SERIALIZER: DBOSPortableJSONSerializer = DBOSPortableJSONSerializer()
"""How DBOS stores what is not stored in the portable format anyway."""


def _refuse(self: DefaultSerializer, text: str) -> Any:
    """In place of unpickling, which lets whoever writes to the database run code in every process.

    Raises:
        TypeError: Always; DBOS takes the value for one that it cannot read.
    """
    raise TypeError("a pickled value is not read")


DefaultSerializer.deserialize = _refuse  # type: ignore


class DatabaseUnavailableError(MorphError):
    """The database does not answer, or refuses."""


class WorkflowTable:
    """The table of workflows, a row each. Calls block; any thread may make them."""

    def __init__(self, client: DBOSClient, settings: Settings) -> None:
        self._client = client
        self._reader = database(settings, autocommit=True)

    @cached_property
    def table(self) -> sa.Table:
        """The table.

        Raises:
            RuntimeError: DBOS has changed it.
        """
        return self._table("workflow_status", COLUMNS)

    @cached_property
    def outcomes(self) -> sa.Table:
        """The table of what they have returned or raised.

        Raises:
            RuntimeError: DBOS has changed it.
        """
        return self._table("workflow_output", OUTCOME_COLUMNS)

    @property
    def name(self) -> str:
        """The name of the table, with its schema."""
        schemas = self._engine.get_execution_options().get("schema_translate_map") or {}
        schema = schemas.get(self.table.schema, self.table.schema)
        return f'"{schema}".{self.table.name}' if schema else self.table.name

    def rows(self, query: Any, values: Mapping[str, Any] | None = None) -> Sequence[Any]:
        """The rows of a query; asked again if its connection turns out to have died in the pool."""
        try:
            return self._rows_now(query, values)
        except sa.exc.DBAPIError as error:
            if not error.connection_invalidated:
                raise
            return self._rows_now(query, values)

    def read(self, ids: list[str], name: str) -> list[WorkflowStatus]:
        """Whole rows of this name, with what they were given and have returned."""
        return self._client.list_workflows(workflow_ids=ids, name=name)

    def notify(self, channel: str) -> None:
        """Tell those who listen; nobody does on SQLite."""
        if self._reader.dialect.name == "postgresql":
            with self._reader.connect() as connection:
                connection.execute(sa.select(sa.func.pg_notify(channel, "")))

    def create_missing(self, table: sa.Table) -> None:
        """Create a table beside that of workflows where it is missing."""
        create_missing(self._engine, table)

    def begin(self) -> AbstractContextManager[sa.Connection]:
        """A transaction that changes the table."""
        return self._engine.begin()

    def attribute(self, name: str) -> sa.ColumnElement[str]:
        """A text attached to a workflow, spelled as in its index."""
        if self._reader.dialect.name == "postgresql":
            return sa.literal_column(f"(attributes ->> '{name}')", sa.String)
        return sa.literal_column(f"json_extract(attributes, '$.{name}')", sa.String)

    def create_indexes(self) -> None:
        """Create what jobs are read and counted by.

        All jobs, an owner's, a sweep's and a method's are listed by age; equal ones share a run.
        """
        c = self.table.c
        owner, age = c.authenticated_user, sa.cast(c.created_at, sa.BigInteger)
        sweep, method = self.attribute("sweep"), self.attribute("method")
        counted = owner, c.status, c.completed_at, c.workflow_deadline_epoch_ms, c.name
        indexes = (
            sa.Index("morph_jobs_by_age", age, c.workflow_uuid),
            sa.Index("morph_jobs_by_owner", owner, age, c.workflow_uuid),
            sa.Index("morph_jobs_by_sweep", sweep, age, c.workflow_uuid),
            sa.Index("morph_jobs_by_method", method, age, c.workflow_uuid),
            sa.Index("morph_jobs_by_owner_and_method", owner, method, age, c.workflow_uuid),
            sa.Index("morph_jobs_by_run", self.attribute("run"), c.workflow_uuid),
            sa.Index("morph_jobs_by_state", *counted),
        )
        with self.begin() as connection:
            if connection.dialect.name == "postgresql":
                connection.execute(sa.text("select pg_advisory_xact_lock(7310247)"))
            for index in indexes:
                connection.execute(sa.schema.CreateIndex(index, if_not_exists=True))

    def delete(self, job_id: str, condition: sa.ColumnElement[bool]) -> bool:
        """Delete a workflow with all that belongs to it; False where the condition does not hold.

        The client of DBOS deletes whatever state the workflow is in by then.
        """
        others = [self._table(name, frozenset({"workflow_uuid"})) for name in PAYLOADS]
        with self.begin() as connection:
            mine = self.table.c.workflow_uuid == job_id
            if not connection.execute(sa.delete(self.table).where(mine, condition)).rowcount:
                return False
            for table in others:
                connection.execute(sa.delete(table).where(table.c.workflow_uuid == job_id))
        return True

    def close(self) -> None:
        """Give the connections back."""
        self._reader.dispose()

    def _table(self, name: str, columns: frozenset[str]) -> sa.Table:
        try:
            table: sa.Table = getattr(self._client._sys_db.tables, name)
            missing = columns - {column.name for column in table.columns}
        except AttributeError as error:
            raise _changed(str(error)) from error
        if missing:
            raise _changed(f"{name} has no {', '.join(sorted(missing))}")
        return table

    @property
    def _engine(self) -> sa.Engine:
        """DBOS's own engine, which knows the schema of the table."""
        engine: sa.Engine = self._client._sys_db.engine
        return engine

    def _rows_now(self, query: Any, values: Mapping[str, Any] | None) -> Sequence[Any]:
        schema = self._engine.get_execution_options()
        with self._reader.connect() as connection:
            return connection.execute(query, values, execution_options=schema).all()


def migrate(settings: Settings) -> None:
    """Create or upgrade the tables of DBOS."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    DBOS.migrate(settings.system_database_url)


def database(settings: Settings, *, autocommit: bool = False, kept: int = CONNECTIONS) -> sa.Engine:
    """An engine for the database of the queue.

    Args:
        settings: Which database.
        autocommit: Spare Postgres the round trips that begin and end a transaction and ask first
            whether the connection lives: they cost more than the query itself.
        kept: Connections to Postgres that stay open. Workers are many, wait for most of their time,
            and share those that Postgres allows.
    """
    url = sa.make_url(settings.database_pooler_url or settings.system_database_url)
    if settings.on_postgres:
        url = url.set(drivername="postgresql+psycopg")
        # of a pooler, statements prepared on one connection may come to another
        unprepared = {"prepare_threshold": None}
        pooled = settings.database_pooler_url
        arguments = TIMEOUTS | (unprepared if pooled else session_options(url))
        if autocommit:
            return sa.create_engine(
                url,
                isolation_level="AUTOCOMMIT",
                pool_size=CONNECTIONS,
                connect_args=arguments,
            )
        return sa.create_engine(
            url,
            connect_args=arguments,
            pool_pre_ping=kept > 1,  # a transaction more; the only one is in use all the time
            pool_size=kept,
            max_overflow=2 * CONNECTIONS - kept,
        )
    engine = sa.create_engine(
        url, connect_args={"timeout": 60, "check_same_thread": False}, pool_size=CONNECTIONS
    )
    sa.event.listen(engine, "connect", _prepare_sqlite)
    return engine


def look_for_jobs_when_woken(name: str) -> Callable[[], None]:
    """Let one queue be looked into when it is worth it, and all else seldom; before the launch.

    DBOS asks every second which queues there are, and looks into one of its own, of which nothing
    is used here. Its threads are never stopped but with the process.

    Args:
        name: Name of the queue.

    Returns:
        Looks into the queue now.
    """
    alarms: list[Alarm] = []
    manage, look = dbos_queue.queue_thread, dbos_queue.queue_worker_thread

    def manage_seldom(stop: threading.Event, dbos: DBOS) -> None:
        manage(_Rest(), dbos)

    def look_when_woken(stop: threading.Event, dbos: DBOS, queue: dbos_queue.Queue) -> None:
        if queue.name != name:
            return look(stop, dbos, queue)
        alarm = Alarm(lambda: dbos._active_workflows_set.count_for_queue(name) > 0)
        alarms.append(alarm)
        look(alarm, dbos, queue)

    dbos_main.queue_thread = manage_seldom  # type: ignore[assignment, attr-defined]
    dbos_queue.queue_worker_thread = look_when_woken  # type: ignore[assignment]

    def wake() -> None:
        for alarm in alarms:
            alarm.ring()

    return wake


class _Rest(threading.Event):
    """In place of an event whose timeouts are the pauses of a thread: makes them long."""

    def wait(self, timeout: float | None = None) -> bool:
        return super().wait(None if timeout is None else max(timeout, REST_SECONDS))


def check_reachable(settings: Settings) -> None:
    """See whether the database answers.

    Raises:
        DatabaseUnavailableError: It does not.
    """
    engine = database(settings)
    try:
        engine.connect().close()
    except (sa.exc.DBAPIError, OSError) as error:
        reason = str(getattr(error, "orig", error)).strip().splitlines()[0]
        raise DatabaseUnavailableError(
            f"The database cannot be used: {reason}.",
            "Start it, or correct MORPH_DATABASE_URL or MORPH_DATA_DIR.",
        ) from error
    finally:
        engine.dispose()


def end_when_refused(engine: sa.Engine) -> None:
    """End this process as soon as the database refuses what DBOS does not ask for again.

    DBOS gives up the outcome of a job whose commit fails so, and the job would run for ever. A
    worker that is started again takes the job up, as after a kill.
    """
    sa.event.listen(engine, "handle_error", _end_if_refused)


def is_disk_full(error: BaseException | None) -> bool:
    """Whether a database refuses to write for want of space."""
    return isinstance(error, psycopg.errors.DiskFull) or (
        isinstance(error, sqlite3.OperationalError) and "disk is full" in str(error)
    )


def _end_if_refused(context: sa.ExceptionContext) -> None:
    if _is_refusal(context.sqlalchemy_exception):
        log.error("the database cannot be used (%s); this worker exits", context.original_exception)
        os._exit(ExitCode.DATABASE_REFUSES)


def _is_refusal(error: BaseException | None) -> bool:
    """Whether a database cannot be used, and neither DBOS nor its queue tries again by itself."""
    if not isinstance(error, sa.exc.OperationalError | sa.exc.InternalError):
        return False
    tried_again = (
        isinstance(error.orig, CONTENTION)
        or retriable_postgres_exception(error)
        or retriable_sqlite_exception(error)
    )
    return is_disk_full(error.orig) or not tried_again


def _prepare_sqlite(connection: sqlite3.Connection, _: object) -> None:
    """Settings of every SQLite connection, and its clock.

    DBOS reads the clock by unixepoch('subsec'), which libsqlite3 before 3.42 lacks, and before
    Python 3.12 by strftime('%s'), which counts whole seconds; both are given milliseconds here.
    """
    connection.isolation_level = "IMMEDIATE"
    connection.execute("pragma journal_mode = wal")
    connection.execute("pragma synchronous = normal")
    connection.execute("pragma busy_timeout = 60000")
    connection.execute("pragma foreign_keys = on")
    for name in ("unixepoch", "strftime"):
        connection.create_function(name, -1, lambda *_: time.time())


def _changed(how: str) -> RuntimeError:
    version = metadata.version("dbos")
    return RuntimeError(f"DBOS {version} stores its workflows in an unexpected way: {how}.")
