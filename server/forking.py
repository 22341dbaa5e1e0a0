"""A new job that begins with the frames of another and goes on from there with other settings.

Its folder is complete before it is in the queue, so that it needs the other job no more.
"""

from __future__ import annotations

from dataclasses import replace

from chamfer_morph.schemas import ForkOrigin, ForkRequest
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.server.context import ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.submission import (
    body_digest,
    check_memory,
    disk_bytes,
    idempotency_conflict,
    idempotent_id,
)
from chamfer_morph.worker.frame_reader import read_run_record
from chamfer_morph.worker.job_listing import DISK_BYTES
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.kept_states import find_state
from morph_engine.cost import estimate_run
from morph_engine.errors import DamagedError, ResultError
from morph_engine.results.fork import begin_fork, forked_config


def fork(
    job: JobRecord, request: ForkRequest, key: str | None, caller: Caller, context: ServerContext
) -> tuple[JobRecord, bool]:
    """Queue a fork of a job, once; the files of the job are here.

    Args:
        job: The job.
        request: Where to fork, and what is to be different.
        key: Idempotency key, if any.
        caller: Whose job it will be.
        context: The service.

    Returns:
        The new job, and whether it is new.

    Raises:
        ConfigError: A setting is unknown, out of range, or has to stay as it is.
        ResourceError: The fork needs more memory than jobs may have.
        ProblemError: 409, there is no state to begin with, or the job goes through several shapes;
            422, the idempotency key belongs to another request; or a limit of the key.
    """
    body = body_digest({"fork": job.id} | request.model_dump(mode="json"))
    fork_id = idempotent_id("fork", caller, key) if key else new_id()
    known = context.queue.get(fork_id) if key else None
    if known is None:
        letting_in = context.quotas.letting_in_jobs(caller.name)
        with letting_in, context.deletions.noted(fork_id):
            _begin(fork_id, body, job, request, caller, context)
        context.quotas.invalidate(caller.name)
    record = known or context.queue.get(fork_id)
    if record is None:
        raise ProblemError(409, "The job has been deleted in the meantime.", "Fork again.")
    if record.attributes.get("body") != body:
        raise idempotency_conflict()
    return record, known is None


def _begin(
    fork_id: str,
    body: str,
    job: JobRecord,
    request: ForkRequest,
    caller: Caller,
    context: ServerContext,
) -> None:
    """Make the folder of a fork, and queue it."""
    storage = context.storage
    if job.spec.via:
        raise ProblemError(
            409,
            "A morph through several shapes cannot be forked.",
            "Submit it with other settings.",
        )
    try:
        state = find_state(storage, job.id, request.frame)
    except DamagedError:
        raise
    except ResultError as error:
        raise ProblemError(409, error.cause, error.remedy) from error
    config = forked_config(job.spec.config, request.overrides, state.frame)
    begun = read_run_record(storage.result_path(job.id))
    assert begun, "it has a state"
    run = replace(begun, config=config)
    expected = estimate_run(run, threads=context.settings.threads or None)
    check_memory(expected.memory_mb, context.settings)
    limit = context.settings.job_timeout_seconds
    spec = job.spec.model_copy(
        update={
            "config": config,
            "timeout_seconds": min(request.timeout_seconds or limit, limit),
            "states_every": request.states_every,
            "fork": ForkOrigin(job=job.id, frame=state.frame),
        }
    )
    needed = disk_bytes(run.particle_count, spec)
    share = (config.frames - state.frame - 1) / config.frames
    inherited = {
        name: job.attributes[name]
        for name in ("method", "preset", "source_name", "target_name", "placement")
        if name in job.attributes
    }
    with context.quotas.promising_disk(caller.name, needed):
        try:
            storage.claim(fork_id, 0)
            begin_fork(storage.result_path(job.id), state, config, storage.result_path(fork_id))
            storage.publish(fork_id)
        except BaseException:
            if context.queue.get(fork_id) is None:  # else another process has made it meanwhile
                storage.remove_job(fork_id)
            raise
        context.queue.enqueue(
            spec,
            job_id=fork_id,
            owner=caller.name,
            priority=request.priority,
            attributes=inherited
            | {
                "name": request.name,
                "body": body,
                "estimate": job.estimate * share,
                DISK_BYTES: needed,
            },
        )
