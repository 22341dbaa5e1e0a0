"""What we use of DBOS beyond its public interface is still there."""

from __future__ import annotations

import typing
from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy as sa
from dbos import WorkflowStatus, _sys_db

from chamfer_morph.schemas import BuiltInShape, JobState
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker import dbos_adapter
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_state import job_state
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


def test_equal_jobs_are_found_by_an_index(queue: JobQueue) -> None:
    """The look-up reads only those, however many others there are."""
    asked: list[tuple[str, tuple[object, ...]]] = []

    def note(_: object, __: object, statement: str, values: tuple[object, ...], *___: object):
        asked.append((statement, values))

    reader = queue._workflows._reader
    sa.event.listen(reader, "before_cursor_execute", note)
    assert queue.succeeded("ann", "0" * 64) == []
    ((statement, values),) = asked
    with reader.connect() as connection:
        plan = connection.exec_driver_sql(f"explain query plan {statement}", values).all()
    assert "morph_jobs_by_run" in str(plan)


def test_every_status_is_known() -> None:
    """Each stands for a state of a job."""
    for status in typing.get_args(_sys_db.WorkflowStatuses):
        assert isinstance(job_state(status), JobState)


def test_another_dbos_is_noticed(queue: JobQueue, monkeypatch: pytest.MonkeyPatch) -> None:
    """A column that has gone is named, with the version, before anything is read."""
    monkeypatch.setattr(dbos_adapter, "COLUMNS", dbos_adapter.COLUMNS | {"colour"})
    with (
        closing(JobQueue(queue._settings)) as another,
        pytest.raises(RuntimeError, match=r"DBOS \d.*workflow_status has no colour"),
    ):
        another.migrate()
