"""What we use of DBOS beyond its public interface is still there."""

from __future__ import annotations

import os
import socket
import sqlite3
import sys
import typing
from collections.abc import Callable
from contextlib import ExitStack, closing
from fnmatch import fnmatch
from pathlib import Path

import pytest
import sqlalchemy as sa
from dbos import WorkflowStatus, _sys_db

from chamfer_morph.schemas import BuiltInShape, JobState
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker import dbos_adapter
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_state import job_state
from chamfer_morph.worker.locks import AdvisoryLock
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.settings import Settings
from morph_engine.presets import configure


@pytest.fixture
def queue(tmp_path: Path):
    """An empty queue."""
    with closing(JobQueue(Settings(_env_file=None, data_dir=tmp_path))) as queue:
        queue.migrate()
        yield queue


def test_the_columns_hold_what_the_public_interface_says(queue: JobQueue) -> None:
    """A job read from the table itself and one read by the client of DBOS are the same."""
    spec = JobSpec(
        source=BuiltInShape(shape="sphere"),
        target=BuiltInShape(shape="star"),
        config=configure("fast").model_dump(mode="json"),
        timeout_seconds=60,
    )
    job_id = new_id()
    queue.enqueue(spec, job_id=job_id, owner="ann", priority=7)
    table = queue._workflows.table
    (row,) = queue._workflows.rows(table.select())
    (status,) = queue._client.list_workflows(workflow_ids=[job_id])
    assert row.workflow_uuid == status.workflow_id == job_id
    for name in ("name", "status", "authenticated_user", "priority", "executor_id", "attributes"):
        assert getattr(row, name) == getattr(status, name), name
    for name in ("created_at", "updated_at", "completed_at", "workflow_deadline_epoch_ms"):
        assert getattr(row, name) == getattr(status, name), name
    queue.cancel(job_id)
    (row,) = queue._workflows.rows(table.select())
    assert row.status == "CANCELLED" and row.completed_at is not None
    with queue._workflows.begin() as connection:
        connection.execute(table.update().values(priority=9))
    (status,) = queue._client.list_workflows(workflow_ids=[job_id])
    assert isinstance(status, WorkflowStatus) and status.priority == 9


@pytest.mark.parametrize(
    ("look_up", "index"),
    [
        (lambda queue: queue.succeeded("ann", "0" * 64), "SEARCH * morph_jobs_by_run "),
        (lambda queue: queue.newest(), "SCAN * morph_jobs_by_age"),
        (lambda queue: queue.newest(owner="ann"), "SEARCH * morph_jobs_by_owner "),
        (lambda queue: queue.newest(sweep="a"), "SEARCH * morph_jobs_by_sweep "),
        (lambda queue: queue.newest(sweep="a", owner="ann"), "SEARCH * morph_jobs_by_sweep "),
        (lambda queue: queue.newest(method="flow"), "SEARCH * morph_jobs_by_method "),
        (
            lambda queue: queue.newest(method="flow", owner="ann"),
            "SEARCH * morph_jobs_by_owner_and_method ",
        ),
        (lambda queue: queue.counts("ann"), "SEARCH * COVERING INDEX morph_jobs_by_state "),
        (lambda queue: queue.counts(), "SCAN * COVERING INDEX morph_jobs_by_state"),
    ],
)
def test_jobs_are_found_by_an_index(
    queue: JobQueue, look_up: Callable[[JobQueue], object], index: str
) -> None:
    """The look-up reads only those, however many others there are, and lists are sorted by it."""
    asked: list[tuple[str, tuple[object, ...]]] = []

    def note(_: object, __: object, statement: str, values: tuple[object, ...], *___: object):
        asked.append((statement, values))

    reader = queue._workflows._reader
    sa.event.listen(reader, "before_cursor_execute", note)
    look_up(queue)
    ((statement, values),) = asked
    with reader.connect() as connection:
        plan = connection.exec_driver_sql(f"explain query plan {statement}", values).all()
    first, *others = [row[-1] for row in plan]
    assert fnmatch(first, f"{index}*"), first
    if "morph_jobs_by_run" not in index:  # equal jobs are few
        assert not any("ORDER BY" in step for step in others), others


def test_finished_jobs_cost_a_submit_nothing(queue: JobQueue) -> None:
    """What is asked for by a submit, and by an owner's wishes, finds queued jobs by an index."""
    plans: list[str] = []

    def explain(_: object, cursor: sqlite3.Cursor, statement: str, values: tuple, *___: object):
        if statement.startswith(("SELECT", "UPDATE")):
            again = cursor.connection.execute(f"explain query plan {statement}", values)
            plans.extend(f"{row[-1]} for {statement}" for row in again.fetchall())

    spec = JobSpec(
        source=BuiltInShape(shape="sphere"),
        target=BuiltInShape(shape="star"),
        config=configure("fast").model_dump(mode="json"),
        device="cpu",
        timeout_seconds=60,
    )
    engines = (queue._engine, queue._workflows._reader)
    for engine in engines:
        sa.event.listen(engine, "before_cursor_execute", explain)
    jobs = [new_id(), new_id()]
    for priority, job in enumerate(reversed(jobs), 1):  # the second has to overtake the first
        queue.enqueue(spec, job_id=job, owner="ann", priority=10 - priority)
    queue.put_first(jobs[0])
    queue.pause("ann")
    queue.unpause("ann")
    assert queue.unfinished("ann") == 2
    assert [queue.position(job) for job in jobs] == [0, 1]
    assert not queue.running() and queue.waiting_since()
    for engine in engines:
        sa.event.remove(engine, "before_cursor_execute", explain)
    assert plans
    assert not [
        plan for plan in plans if "SCAN" in plan and "workflow_status" in plan.split(" for ")[0]
    ]


def test_every_status_is_known() -> None:
    """Each stands for a state of a job."""
    for status in typing.get_args(_sys_db.WorkflowStatuses):
        assert isinstance(job_state(status, late=False), JobState)


def test_another_dbos_is_noticed(queue: JobQueue, monkeypatch: pytest.MonkeyPatch) -> None:
    """A column that has gone is named, with the version, before anything is read."""
    monkeypatch.setattr(dbos_adapter, "COLUMNS", dbos_adapter.COLUMNS | {"colour"})
    with (
        closing(JobQueue(queue._settings)) as another,
        pytest.raises(RuntimeError, match=r"DBOS \d.*workflow_status has no colour"),
    ):
        another.migrate()


@pytest.mark.skipif(sys.platform != "linux", reason="options of sockets as of Linux")
def test_no_connection_waits_long_for_a_silent_postgres(postgres: str, tmp_path: Path) -> None:
    """Those of all pools and that of a lock end when nothing comes or goes for half a minute."""
    settings = Settings(_env_file=None, data_dir=tmp_path, database_url=postgres)
    lock = AdvisoryLock.take(settings.system_database_url, "worker of a test")
    assert lock is not None
    engines = [dbos_adapter.database(settings, autocommit=each) for each in (False, True)]
    with ExitStack() as stack:
        stack.callback(lock.release)
        connections = [lock._connection]
        for engine in engines:
            stack.callback(engine.dispose)
            found = stack.enter_context(engine.connect())
            connections.append(found.connection.driver_connection)
        for connection in connections:
            parameters = connection.info.get_parameters()
            assert 0 < int(parameters["connect_timeout"]) <= 10
            with socket.socket(fileno=os.dup(connection.fileno())) as link:
                options = [socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT]
                idle, interval, count = (link.getsockopt(socket.IPPROTO_TCP, o) for o in options)
                assert link.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
                assert idle + interval * count <= 30
                unsent = link.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
                assert 0 < unsent <= 30_000


def test_settings_of_sessions(postgres: str) -> None:
    """Those of ours and those of the URL hold."""
    url = sa.make_url(postgres).update_query_dict({"options": "-c work_mem=7MB"})
    engine = dbos_adapter.database(
        Settings(_env_file=None, database_url=url.render_as_string(hide_password=False))
    )
    with engine.connect() as connection:
        for name, value in {
            "idle_in_transaction_session_timeout": "15s",
            "work_mem": "7MB",
        }.items():
            assert connection.execute(sa.text(f"show {name}")).scalar_one() == value
    engine.dispose()


class Refused(Exception):
    """In place of the end of this process."""


def end(status: int) -> None:
    """In place of `os._exit`."""
    raise Refused(status)


def test_what_nobody_asks_for_again_ends_the_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A SQLite database that cannot be written, or is not there, and not one that is locked."""
    monkeypatch.setattr(os, "_exit", end)
    engine = dbos_adapter.database(Settings(_env_file=None, data_dir=tmp_path))
    dbos_adapter.end_when_refused(engine)
    with engine.begin() as connection:
        connection.exec_driver_sql("create table t (x)")
    with engine.connect() as one, engine.connect() as other:
        other.exec_driver_sql("pragma busy_timeout = 0")
        other.rollback()
        one.exec_driver_sql("insert into t values (1)")
        with pytest.raises(sa.exc.OperationalError, match="locked"):
            other.exec_driver_sql("insert into t values (2)")
    with engine.connect() as connection:
        connection.exec_driver_sql("pragma query_only = on")
        with pytest.raises(Refused):
            connection.exec_driver_sql("insert into t values (3)")
        connection.exec_driver_sql("pragma query_only = off")
    engine.dispose()
    nowhere = dbos_adapter.database(Settings(_env_file=None, data_dir=tmp_path / "nowhere"))
    dbos_adapter.end_when_refused(nowhere)
    with pytest.raises(Refused):
        nowhere.connect()


def test_contention_does_not_end_the_worker(
    postgres: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of Postgres that another one has locked; a read-only database does."""
    monkeypatch.setattr(os, "_exit", end)
    engine = dbos_adapter.database(
        Settings(_env_file=None, data_dir=tmp_path, database_url=postgres)
    )
    dbos_adapter.end_when_refused(engine)
    table = f"t_{os.urandom(8).hex()}"
    with engine.begin() as connection:
        connection.exec_driver_sql(f"create table {table} as select 1 as x")
    try:
        query = f"select * from {table} for update nowait"
        with engine.connect() as one, engine.connect() as other:
            one.exec_driver_sql(query)
            with pytest.raises(sa.exc.OperationalError, match="lock"):
                other.exec_driver_sql(query)
        with engine.connect() as connection:
            connection.exec_driver_sql("set transaction read only")
            with pytest.raises(Refused):
                connection.exec_driver_sql(f"insert into {table} values (2)")
    finally:
        with engine.begin() as connection:
            connection.exec_driver_sql(f"drop table {table}")
        engine.dispose()
