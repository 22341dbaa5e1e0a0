"""What a worker slot does with a job, as a DBOS workflow."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from pathlib import Path
from typing import Any

from dbos import DBOS, DBOSConfig, PortableWorkflowError, WorkflowSerializationFormat
from dbos import error as dbos_error

from chamfer_morph.schemas import Problem
from chamfer_morph.worker import queue
from chamfer_morph.worker.attempt import AttemptFailed, run_attempt
from chamfer_morph.worker.dbos_adapter import (
    SERIALIZER,
    database,
    end_when_disk_is_full,
    let_internal_queue_rest,
)
from chamfer_morph.worker.engines.spare_engine import SpareEngine
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.slots import is_paused
from chamfer_morph.worker.storage import Storage
from chamfer_morph.worker.tasks.write_partial_result import LOCK_SECONDS

MAX_RECOVERIES = 50

_settings: Settings
_executor: str
_spare: SpareEngine


def launch(settings: Settings, executor: str, spare: SpareEngine, *, listen: bool = True) -> None:
    """Start working under the name of a slot; jobs it left behind are taken up again.

    Args:
        settings: Database, storage and limits.
        executor: Name of the slot.
        spare: Where engine processes come from.
        listen: Whether to take new jobs.
    """
    global _settings, _executor, _spare
    _settings, _executor, _spare = settings, executor, spare
    engine = database(settings, kept=1)
    end_when_disk_is_full(engine)
    config: DBOSConfig = {
        "name": queue.APPLICATION,
        "system_database_url": settings.system_database_url,
        "system_database_engine": engine,
        "executor_id": executor,
        "application_version": queue.APPLICATION_VERSION,
        "run_migrations": False,
        "use_listen_notify": False,  # nobody waits for what it would tell, on a connection more
        "serializer": SERIALIZER,
        "log_level": "WARNING",
        "max_executor_threads": 8,
    }
    DBOS(config=config)
    let_internal_queue_rest()
    logging.getLogger("dbos").addFilter(_is_unexpected)
    DBOS.listen_queues([queue.QUEUE] if listen else [])
    DBOS.launch()


@DBOS.workflow(
    name=queue.WORKFLOW,
    max_recovery_attempts=MAX_RECOVERIES,
    serialization_type=WorkflowSerializationFormat.PORTABLE,
)
async def morph(spec: dict[str, Any]) -> dict[str, Any]:
    """Compute a job."""
    if is_paused(_settings.data_dir, _executor):
        os._exit(ExitCode.PAUSED)  # the job goes to another slot
    try:
        return await compute(spec)
    except AttemptFailed as failure:
        problem = failure.problem
        raise PortableWorkflowError(
            problem.cause, "JobFailed", None, problem.model_dump(mode="json")
        ) from None


@DBOS.step(preemptible=True)
async def compute(spec: dict[str, Any]) -> dict[str, Any]:
    """Attempt a job until it succeeds, is refused, or has failed too often."""
    job_id = DBOS.workflow_id
    assert job_id is not None
    storage = Storage(_settings.data_dir)
    job_dir = storage.job_dir(job_id)
    try:
        job_dir.mkdir(exist_ok=True)
        await asyncio.to_thread(storage.discard_if_marked, job_id, wait_seconds=LOCK_SECONDS)
        _write_spec(job_dir, spec)
    except OSError as error:
        raise AttemptFailed(_disk_refuses(error), 0) from error
    log = storage.events(job_id)
    failures = 0
    attempt = 1 + sum(1 for event in log.read(limit=10**9) if event.type == "attempt")
    while True:
        try:
            outcome = await run_attempt(job_dir, attempt, _settings, _spare, _heartbeat)
            return outcome.model_dump(mode="json")
        except AttemptFailed as failure:
            failures = 1 if failure.frames else failures + 1  # progress earns new patience
            again = failure.worth_another and failures < _settings.attempts
            with contextlib.suppress(OSError):  # the disk is full; the outcome tells it, too
                log.append(
                    "problem",
                    {"attempt": attempt, "retry": again, **failure.problem.model_dump(mode="json")},
                )
            if not again:
                raise
        await asyncio.sleep(_settings.retry_seconds * 2 ** (failures - 1))
        attempt += 1


def _disk_refuses(error: OSError) -> Problem:
    return Problem(
        cause=f"The job's folder cannot be written ({error.strerror or error}).",
        remedy="See that the service's disk has room, then resume the job.",
        kind="resources",
    )


def _is_unexpected(record: logging.LogRecord) -> bool:
    """Leave cancelled jobs, which DBOS reports with a traceback, out of the log."""
    cancelled = (
        dbos_error.DBOSAwaitedWorkflowCancelledError,
        dbos_error.DBOSWorkflowCancelledError,
    )
    return not (record.exc_info and isinstance(record.exc_info[1], cancelled))


async def _heartbeat() -> None:
    """Raise if this slot has lost the job: the database lets only its owner write."""
    await DBOS.set_event_async("beat", 0)


def _write_spec(job_dir: Path, spec: dict[str, Any]) -> None:
    text = JobSpec.model_validate(spec).model_dump_json(indent=1)
    path = job_dir / "spec.json"
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
