"""What a worker slot does with a job, as a DBOS workflow."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from dbos import DBOS, DBOSConfig, PortableWorkflowError, WorkflowSerializationFormat
from dbos import error as dbos_error
from sqlalchemy.exc import DBAPIError

from chamfer_morph.schemas import MeshShape, Outcome, Problem
from chamfer_morph.worker import job_trace, queue, service_log, telemetry
from chamfer_morph.worker.attempt import AttemptFailed, run_attempt
from chamfer_morph.worker.dbos_adapter import (
    SERIALIZER,
    database,
    end_when_refused,
    look_for_jobs_when_woken,
)
from chamfer_morph.worker.engines.spare_engine import SpareEngine
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.own_queue import QUEUE, WORKFLOW
from chamfer_morph.worker.publication import patiently, publishing
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.slots import WorkerSlots
from chamfer_morph.worker.storage import (
    OwnershipLostError,
    Storage,
    StoreUnavailableError,
    open_storage,
)
from chamfer_morph.worker.tasks.write_partial_result import LOCK_SECONDS

MAX_RECOVERIES = 50

JOB_FAILED = "JobFailed"
"""What DBOS calls the error of a failed job."""

_log: logging.Logger = logging.getLogger("chamfer_morph.jobs")

_settings: Settings
_executor: str
_spare: SpareEngine
_slots: WorkerSlots


def launch(
    settings: Settings, executor: str, spare: SpareEngine, *, listen: bool = True
) -> Callable[[], None]:
    """Start working under the name of a slot; jobs it left behind are taken up again.

    Args:
        settings: Database, storage and limits.
        executor: Name of the slot.
        spare: Where engine processes come from.
        listen: Whether to take new jobs.

    Returns:
        Makes it look for a job at once.
    """
    global _settings, _executor, _spare, _slots
    _settings, _executor, _spare = settings, executor, spare
    engine = database(settings, kept=1)
    _slots = WorkerSlots(engine)
    end_when_refused(engine)
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
    look = look_for_jobs_when_woken(QUEUE)
    logging.getLogger("dbos").addFilter(_is_unexpected)
    DBOS.listen_queues([QUEUE] if listen else [])
    DBOS.launch()
    return look


@DBOS.workflow(
    name=WORKFLOW,
    max_recovery_attempts=MAX_RECOVERIES,
    serialization_type=WorkflowSerializationFormat.PORTABLE,
)
async def morph(spec: dict[str, Any]) -> dict[str, Any]:
    """Compute a job."""
    with contextlib.suppress(DBAPIError):  # of no weight when the database has a hiccup
        if await asyncio.to_thread(_slots.is_paused, _executor):
            os._exit(ExitCode.PAUSED)  # the job goes to another slot
    try:
        return await compute(spec)
    except AttemptFailed as failure:
        problem = failure.problem
        fields = {"job": DBOS.workflow_id, "kind": problem.kind}
        why = " ".join(problem.cause.split())
        _log.warning("job %s has failed: %s", DBOS.workflow_id, why, extra={"fields": fields})
        raise PortableWorkflowError(
            problem.cause, JOB_FAILED, None, problem.model_dump(mode="json")
        ) from None


@DBOS.step(preemptible=True)
async def compute(spec: dict[str, Any]) -> dict[str, Any]:
    """Attempt a job until it succeeds, is refused, or has failed too often."""
    job_id = DBOS.workflow_id
    assert job_id is not None
    service_log.job_id.set(job_id)
    attributes = await _attributes(job_id)
    service_log.request_id.set(str(attributes.get(job_trace.REQUEST_ID, "")))
    with job_trace.run_of(job_id, attributes, _executor) as run:
        return await _compute(job_id, JobSpec.model_validate(spec), run)


async def _attributes(job_id: str) -> dict[str, Any]:
    """What is attached to the job, for logs and traces; nothing while the database is away."""
    with contextlib.suppress(DBAPIError):
        status = await DBOS.get_workflow_status_async(job_id)
        return (status and status.attributes) or {}
    return {}


async def _compute(job_id: str, spec: JobSpec, run: job_trace.Run) -> dict[str, Any]:
    storage = open_storage(_settings, _executor)
    try:
        outcome = await _attempt(storage, job_id, spec, run)
        with _explaining():
            await patiently(partial(storage.publish, job_id), _settings.object_store_seconds)
    except BaseException:
        with contextlib.suppress(OSError, OwnershipLostError, StoreUnavailableError):
            await asyncio.to_thread(storage.publish, job_id)
            storage.release(job_id)
        raise
    storage.release(job_id)
    return outcome.model_dump(mode="json")


async def _attempt(storage: Storage, job_id: str, spec: JobSpec, run: job_trace.Run) -> Outcome:
    """Attempt a job until it succeeds, is refused, or has failed too often."""
    log = storage.events(job_id)
    attempt, failures = 0, 0
    while True:
        try:
            with _explaining():
                await patiently(
                    partial(_take_over, storage, job_id, spec), _settings.object_store_seconds
                )
            events = log.read(limit=10**9)
            if not attempt:
                run.record_wait(events)
            begun = sum(event.type == "attempt" for event in events)
            attempt = max(attempt, begun) + 1
            _tell("begins", attempt=attempt, worker=_executor)
            with telemetry.span("attempt", {"morph.attempt": attempt}):
                async with publishing(storage, job_id) as publication:
                    beat = partial(_heartbeat, publication)
                    with _explaining():
                        outcome = await run_attempt(
                            storage.job_dir(job_id), attempt, _settings, _spare, beat
                        )
            _tell("done", attempt=attempt, worker=_executor)
            return outcome
        except AttemptFailed as failure:
            failures = 1 if failure.frames else failures + 1  # progress earns new patience
            again = failure.worth_another and failures < _settings.attempts
            _tell("failed", attempt=attempt, retry=again, cause=failure.problem.cause)
            with contextlib.suppress(OSError):  # the disk is full; the outcome tells it, too
                log.append(
                    "problem",
                    {"attempt": attempt, "retry": again, **failure.problem.model_dump(mode="json")},
                )
            if not again:
                raise
        await asyncio.sleep(_settings.retry_seconds * 2 ** (failures - 1))


def _tell(what: str, **fields: Any) -> None:
    """Log what becomes of the job."""
    _log.info("%s: %s", what, fields, extra={"fields": {"message": what, **fields}})


def _take_over(storage: Storage, job_id: str, spec: JobSpec) -> None:
    """See to it that this host, and no other, has what the job needs and has left so far."""
    storage.discard_if_marked(job_id, wait_seconds=LOCK_SECONDS)
    storage.claim(job_id, LOCK_SECONDS)
    for shape in spec.shapes:
        if isinstance(shape, MeshShape):
            storage.mesh_file(shape.mesh)
    _write_spec(storage.job_dir(job_id), spec)


@contextlib.contextmanager
def _explaining() -> Iterator[None]:
    """Tell what the files of a job have suffered as a failure of the attempt."""
    try:
        yield
    except OSError as error:
        raise AttemptFailed(_disk_refuses(error), 0) from error
    except StoreUnavailableError as error:
        remedy = "Check that the object store answers, then resume the job."
        problem = Problem(cause=error.cause, remedy=remedy, kind="resources")
        raise AttemptFailed(problem, 0) from error
    except OwnershipLostError as error:
        problem = Problem(
            cause="Another worker has taken over the job's files.",
            remedy="If that happens again, check that each worker slot has a unique name.",
            kind="crash",
        )
        raise AttemptFailed(problem, 0) from error


def _disk_refuses(error: OSError) -> Problem:
    return Problem(
        cause=f"The job's folder cannot be written to ({error.strerror or error}).",
        remedy="Check that the disk of the service is writable and has free space, then resume "
        "the job.",
        kind="resources",
    )


def _is_unexpected(record: logging.LogRecord) -> bool:
    """Leave cancelled and failed jobs, of which DBOS prints tracebacks, out of the log."""
    error = record.exc_info[1] if record.exc_info else None
    cancelled = (
        dbos_error.DBOSAwaitedWorkflowCancelledError,
        dbos_error.DBOSWorkflowCancelledError,
    )
    failed = isinstance(error, PortableWorkflowError) and error.name == JOB_FAILED
    return not (failed or isinstance(error, cancelled))


async def _heartbeat(publication: asyncio.Task[None]) -> None:
    """Raise if this slot has lost the job: database and object store let only its owner write."""
    await DBOS.set_event_async("beat", 0)
    if publication.done():
        with _explaining():
            publication.result()


def _write_spec(job_dir: Path, spec: JobSpec) -> None:
    text = spec.model_dump_json(indent=1)
    path = job_dir / "spec.json"
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
