"""Dependencies of the endpoints of a job: the job itself, a frame, its run record, its result."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from functools import partial
from pathlib import Path
from typing import Annotated, NoReturn

import anyio
from fastapi import Depends, Request

from chamfer_morph.schemas.ids import is_id
from chamfer_morph.server.auth import JobReader
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.problems import ProblemError, not_found
from chamfer_morph.worker.frame_reader import Frame, has_unsaved_frames, read_frame, read_run_record
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.job_state import Action, allowed
from chamfer_morph.worker.queue import JobChangedError
from chamfer_morph.worker.storage import StoreUnavailableError
from morph_engine.errors import DamagedError, MorphError
from morph_engine.results.run_record import RunRecord

_LOG = logging.getLogger(__name__)

LAST_FILES = timedelta(minutes=1)
"""How long after its end the last files of a job may come; a stopped engine takes a moment."""

AWAY_SECONDS = 60.0
"""How long an object store that has not answered is not asked for events again."""


def find_job(job_id: str, caller: JobReader, context: Context) -> JobRecord:
    """A job that the caller may see, by a key or a share link.

    Raises:
        ProblemError: 404.
    """
    record = context.queue.get(job_id) if is_id(job_id) else None
    if record is None or not caller.can_see_job(record):
        raise not_found("job", job_id)
    fetch_logs([record], context)
    return record


def fetch(job: JobRecord, context: ServerContext, *, log_only: bool = False) -> None:
    """See to it that the files of a job are here, where hosts share no folder.

    Raises:
        StoreUnavailableError: The object store does not answer.
    """
    finished = job.finished_at
    rests = finished and datetime.now(timezone.utc) - finished > LAST_FILES
    context.storage.fetch(job.id, finished if rests else None, log_only=log_only)


def fetch_logs(jobs: Sequence[JobRecord], context: ServerContext) -> None:
    """See to it that the events of jobs are here; where the object store does not answer, those
    that are here already have to do, and it is not asked again for a while: that may take long.
    """  # noqa: D205
    if time.monotonic() < context.store_is_away_until:
        return
    try:
        for job in jobs:
            fetch(job, context, log_only=True)
    except StoreUnavailableError:
        context.store_is_away_until = time.monotonic() + AWAY_SECONDS
        _LOG.warning("the object store does not answer; the progress of jobs may be out of date")


VisibleJob = Annotated[JobRecord, Depends(find_job)]


def find_frame(index: int, job: VisibleJob, context: Context) -> Frame:
    """A frame of a job; -1 is the last one.

    Raises:
        ProblemError: 404.
        ResultError: It is damaged.
    """
    fetch(job, context)
    frame = read_frame(context.storage.result_path(job.id), index)
    if frame is None:
        yet = "" if job.state.finished else " yet"
        raise ProblemError(
            404,
            f"There is no frame {index}{yet}.",
            "Check the job's progress for the number of frames.",
        )
    return frame


FinishedFrame = Annotated[Frame, Depends(find_frame)]


def find_run_record(job: JobRecord, context: ServerContext) -> RunRecord:
    """What a job is made of.

    Raises:
        ProblemError: 404, it has not begun.
    """
    fetch(job, context)
    run = read_run_record(context.storage.result_path(job.id))
    if run is None:
        if job.state.finished:
            raise ProblemError(
                404, "The job never started and has no particles.", "Retry or resume it."
            )
        raise ProblemError(
            404,
            "The job has not started and has no particles yet.",
            "Wait until it runs; until then /v1/shapes and /v1/meshes give the particles "
            "of a shape.",
        )
    return run


async def find_result(job: JobRecord, request: Request, context: ServerContext) -> Path:
    """The result file of a finished job, with all its frames.

    Raises:
        ProblemError: 409, there is none; 503, its engine was killed, and its frames cannot be made
            a result now.
        DamagedError: One of these frames cannot be read, or the file of a succeeded job has gone.
        JobChangedError: It has been retried or deleted meanwhile.
    """
    await anyio.to_thread.run_sync(fetch, job, context)
    path = context.storage.result_path(job.id)
    if job.state.finished and await anyio.to_thread.run_sync(has_unsaved_frames, path):
        compute = partial(context.sandbox.write_partial_result, job.id)
        try:
            await context.partial_results.get((job.id,), compute, request, job.owner)
        except DamagedError:
            raise
        except MorphError as error:  # nothing is wrong with the request
            retry = {"Retry-After": "60"}
            raise ProblemError(503, error.cause, error.remedy, headers=retry) from error
    if job.outcome is not None and not path.is_file():
        await anyio.to_thread.run_sync(refuse_lost, job, f"{path} is missing.", context)
    if not job.state.finished or not path.is_file():
        raise ProblemError(
            409,
            f"The job is {job.state.value.replace('_', ' ')} and has no result.",
            "Resume or retry it; it has not finished any frame."
            if job.state.finished
            else "Wait for it to finish; single frames can be fetched while it runs.",
            headers={} if job.state.finished else {"Retry-After": "5"},
        )
    return path


def refuse_lost(job: JobRecord, cause: str, context: ServerContext) -> NoReturn:
    """Say that the result of a succeeded job is not here as it was.

    Raises:
        JobChangedError: The job has been retried or deleted since its record was read.
        DamagedError: It has not.
    """
    now = context.queue.get(job.id)
    if now is None or (now.outcome, now.finished_at) != (job.outcome, job.finished_at):
        raise JobChangedError
    raise DamagedError(
        cause, "Check that MORPH_DATA_DIR is the right folder and mounted, or retry the job."
    )


def check_allowed(job: JobRecord, action: Action) -> None:
    """Refuse what makes no sense in the state of a job.

    Raises:
        ProblemError: 409.
    """
    if allowed(job.state, action):
        return
    remedies = {
        "cancel": "It has already ended.",
        "next": "It has already started or ended.",
        "resume": "Only a failed, cancelled or timed out job can be resumed; retry starts from the "
        "beginning.",
        "retry": "Cancel it first.",
        "delete": "Cancel it first.",
    }
    verb = {
        "cancel": "cancelled",
        "next": "moved to the front",
        "resume": "resumed",
        "retry": "retried",
        "delete": "deleted",
    }
    raise ProblemError(409, f"A {job.state.value} job cannot be {verb[action]}.", remedies[action])
