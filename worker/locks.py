"""A worker is alive as long as it holds the lock named after it.

On SQLite the lock is a file lock, which the system frees when the process dies, however it dies. On
Postgres it is an advisory lock on a connection of its own, which the server closes when the worker
falls silent. Whoever gets the lock of a worker that still has jobs knows that the worker is gone.
The same connection hears of new jobs.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Collection
from typing import BinaryIO

import psycopg
import sqlalchemy as sa

from chamfer_morph.worker.alarm import CHANNEL
from chamfer_morph.worker.postgres_timeouts import TIMEOUTS
from chamfer_morph.worker.settings import Settings
from morph_engine.files import acquire

SILENCE_SECONDS = 15
WAIT_SECONDS = 0.2

HELD_NUMBERS: sa.TextClause = sa.text(
    "select classid::bigint, objid::bigint from pg_locks "
    "where locktype = 'advisory' and objsubid = 1 and granted "
    "and database = (select oid from pg_database where datname = current_database())"
)
"""Upper and lower 32 bits of the numbers of advisory locks that somebody holds."""


def try_lock(settings: Settings, executor: str) -> FileLock | AdvisoryLock | None:
    """The lock of a worker slot, or None while somebody holds it.

    Raises:
        psycopg.OperationalError: Postgres does not answer.
    """
    if settings.on_postgres:
        return AdvisoryLock.take(settings.system_database_url, executor)
    file = acquire(settings.data_dir / "locks" / executor)
    return FileLock(file) if file else None


def wait_for_lock(
    settings: Settings, executor: str, seconds: float
) -> FileLock | AdvisoryLock | None:
    """The lock of a worker slot, or None where somebody holds it for longer than this [s].

    Raises:
        psycopg.OperationalError: Postgres does not answer.
    """
    deadline = time.monotonic() + seconds
    while (lock := try_lock(settings, executor)) is None and time.monotonic() < deadline:
        time.sleep(WAIT_SECONDS)
    return lock


def living(settings: Settings, engine: sa.Engine, executors: Collection[str]) -> set[str]:
    """Those of some worker slots that live; one query on Postgres, however many there are.

    Args:
        settings: Where the locks are.
        engine: The database of the queue.
        executors: Names of the slots.
    """
    if not settings.on_postgres:
        return {executor for executor in executors if _is_held(settings, executor)}
    with engine.connect() as connection:
        held = {high << 32 | low for high, low in connection.execute(HELD_NUMBERS)}
    return {executor for executor in executors if _number(executor) % (1 << 64) in held}


def lock_transaction(connection: sa.Connection, name: str) -> None:
    """Let no other transaction that asks for this name go on before this one has ended.

    Only Postgres needs it: SQLite has one writer anyway.
    """
    if connection.dialect.name == "postgresql":
        number = sa.func.hashtextextended(name, 0)
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(number)))


class FileLock:
    """A lock on an open file."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def held(self) -> bool:
        """True: the system takes it from no living process."""
        return True

    def wait_for_news(self, ended: threading.Event, seconds: float) -> bool:
        """Wait until told to end, or for so long [s]; False, for a file tells nothing."""
        ended.wait(seconds)
        return False

    def release(self) -> None:
        """Close the file."""
        self._file.close()


class AdvisoryLock:
    """A session-level advisory lock; needs a direct connection, no transaction pooler."""

    def __init__(self, connection: psycopg.Connection) -> None:
        self._connection = connection
        self._listens = False

    @classmethod
    def take(cls, url: str, executor: str) -> AdvisoryLock | None:
        """Connect and lock, or None if another session holds it."""
        plain = sa.make_url(url).set(drivername="postgresql")
        connection = psycopg.connect(
            plain.render_as_string(hide_password=False), autocommit=True, **TIMEOUTS
        )
        connection.execute(f"set idle_session_timeout = '{SILENCE_SECONDS}s'")
        row = connection.execute("select pg_try_advisory_lock(%s)", (_number(executor),)).fetchone()
        if not row or not row[0]:
            connection.close()
            return None
        return cls(connection)

    def held(self) -> bool:
        """Whether the session still lives."""
        try:
            self._connection.execute("select 1")
        except psycopg.Error:
            return False
        return True

    def wait_for_news(self, ended: threading.Event, seconds: float) -> bool:
        """Wait for a notification of a job, for so long [s]; True if one has come."""
        try:
            if not self._listens:
                self._connection.execute(f"listen {CHANNEL}")
                self._listens = True
            return any(True for _ in self._connection.notifies(timeout=seconds, stop_after=1))
        except psycopg.Error:  # `held` tells it
            ended.wait(seconds)
            return False

    def release(self) -> None:
        """Close the session."""
        self._connection.close()


def _is_held(settings: Settings, executor: str) -> bool:
    lock = try_lock(settings, executor)
    if lock is not None:
        lock.release()
    return lock is None


def _number(executor: str) -> int:
    """What Postgres knows a lock by: 64 bits with a sign."""
    digest = hashlib.sha256(f"morph worker {executor}".encode()).digest()
    return int.from_bytes(digest[:8], "big", signed=True)
