"""/v1/jobs: submit, list, show, put first, cancel, resume, retry, fork, delete."""

from __future__ import annotations

import json
from contextlib import AsyncExitStack, suppress
from typing import Annotated, Any

import anyio
from fastapi import APIRouter, Body, Header, Query, Request, Response
from fastapi.openapi.models import Example
from starlette.datastructures import UploadFile

from chamfer_morph.schemas import ForkRequest, Job, JobPage, JobRequest, JobState
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.server.auth import AuthenticatedRoute, JobReader, Reader, Submitter
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.forking import fork
from chamfer_morph.server.http import cursors
from chamfer_morph.server.http.problems import ProblemError, too_large
from chamfer_morph.server.http.request_body import load_json, media_type, read_json, validate
from chamfer_morph.server.http.uploads import (
    enter_in_thread,
    read_blocks,
    receive_form,
    save_upload,
)
from chamfer_morph.server.routes.job_lookup import (
    VisibleJob,
    check_allowed,
    fetch,
    fetch_logs,
    find_job,
)
from chamfer_morph.server.routes.job_view import to_job, to_json
from chamfer_morph.server.routes.meshes import discard_meshes, store_uploads
from chamfer_morph.server.submission import (
    check_meshes,
    idempotency_conflict,
    idempotent_id,
    prepare,
    request_digest,
    submit,
)
from chamfer_morph.worker.job_listing import DISK_BYTES
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.queue import JobChangedError
from chamfer_morph.worker.storage import StoreUnavailableError
from morph_engine.errors import MorphError

router: APIRouter = APIRouter(prefix="/jobs", tags=["jobs"], route_class=AuthenticatedRoute)

RETRY_AFTER = "1"
"""When to look again at what was queued [s]."""

EXAMPLES: dict[str, Any] = {
    "sphere to star": {
        "summary": "Two built-in shapes",
        "value": {"source": {"shape": "sphere"}, "target": {"shape": "star"}},
    },
    "quick": {
        "summary": "Fewer particles and frames",
        "value": {
            "source": {"shape": "sphere"},
            "target": {"shape": "text:Hi"},
            "preset": "fast",
            "overrides": {"sampling.points_per_cell_edge": 2, "chamfer.weight": 5},
            "method": "joint",
            "frames": 12,
            "seed": 7,
            "name": "a first look",
        },
    },
}

FORK_EXAMPLES: dict[str, Example] = {
    "stiffer": {
        "summary": "Stiffer from frame 1 on",
        "value": {"frame": 1, "overrides": {"material.youngs_modulus": 200000}},
    }
}

# JSON or a form, and the files of a form are streamed: FastAPI has no parameter for either
SUBMIT_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": "#/components/schemas/JobRequest"},
                "examples": EXAMPLES,
            },
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["job"],
                    "properties": {
                        "job": {
                            "type": "string",
                            "contentMediaType": "application/json",
                            "description": "A JobRequest without the shapes sent as files.",
                        },
                        "source": {"type": "string", "format": "binary"},
                        "target": {"type": "string", "format": "binary"},
                    },
                }
            },
        },
    }
}

IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=255,
        pattern=r"^[\x20-\x7e]+$",
        description="Any text; a request with the same key returns the same job instead of making "
        "another.",
    ),
]
PlainText = Query(max_length=200, pattern=r"^[^\x00]*$")


@router.post(
    "",
    status_code=202,
    operation_id="submitJob",
    summary="Submit a job",
    responses={
        200: {"model": Job, "description": "The job already made with this Idempotency-Key."}
    },
    openapi_extra=SUBMIT_BODY,
)
async def submit_job(
    request: Request,
    response: Response,
    caller: Submitter,
    context: Context,
    idempotency_key: IdempotencyKey = None,
) -> Job:
    """Queue a morph between uploaded meshes or built-in shapes.

    Send JSON, or a form with the JSON in a part `job` and mesh files in parts `source` and
    `target`. Everything is checked first, so a job that is accepted can run.
    """
    async with AsyncExitStack() as stack:
        added: list[str] = []
        if media_type(request) == "multipart/form-data":
            body, added = await _receive_form(request, caller, context, stack)
        else:
            body = await read_json(request, JobRequest, context.settings.body_bytes)
        try:
            job, new = await anyio.to_thread.run_sync(
                _submit, body, idempotency_key, caller, context
            )
        except (MorphError, ProblemError):
            await anyio.to_thread.run_sync(discard_meshes, added, caller, context)
            raise
    accept(response, f"/v1/jobs/{job.id}", new=new)
    return job


@router.get("", operation_id="listJobs", summary="List jobs", response_model=JobPage)
def list_jobs(
    caller: Reader,
    context: Context,
    state: Annotated[list[JobState], Query(description="Only these states.")] = [],  # noqa: B006
    method: Annotated[str | None, PlainText] = None,
    sweep: Annotated[str | None, PlainText] = None,
    owner: Annotated[str | None, PlainText] = None,
    limit: cursors.Limit = 50,
    cursor: cursors.Cursor = None,
) -> Response:
    """Your jobs, the newest first; everybody's for an admin key.

    `queue_position` is left out here; ask for a single job.
    """
    if owner is not None and not caller.can_see(owner):
        raise ProblemError(403, "These jobs belong to another key.", "Omit `owner`.")
    records = context.queue.newest(
        owner=caller.owner_filter if owner is None else owner,
        states=set(state) or None,
        sweep=sweep,
        method=method,
        before=cursors.decode_cursor(cursor),
        limit=limit + 1,
    )
    page, more = records[:limit], len(records) > limit
    fetch_logs(page, context)
    items = b",".join(to_json(record, context, alone=False) for record in page)
    following = cursors.encode_cursor(*page[-1].age_and_id) if more else None
    body = b'{"items":[%b],"next_cursor":%b}' % (items, json.dumps(following).encode())
    return Response(body, media_type="application/json")


@router.get("/{job_id}", operation_id="getJob", summary="Show a job", response_model=Job)
def get_job(caller: JobReader, job: VisibleJob, context: Context) -> Response:
    """The state of a job, its progress, and its outcome.

    With a share link, its owner and sweep are not shown.
    """
    if caller.shared is not None:
        shown = to_job(job, context).model_copy(update={"owner": "", "sweep": None})
        return Response(shown.model_dump_json(), media_type="application/json")
    return Response(to_json(job, context), media_type="application/json")


@router.delete("/{job_id}", status_code=204, operation_id="deleteJob", summary="Delete a job")
def delete_job(caller: Submitter, job: VisibleJob, context: Context) -> None:
    """Delete a finished job and all its files."""
    check_allowed(job, "delete")
    with suppress(StoreUnavailableError), context.deletions.noted(job.id):
        if not context.queue.delete_finished(job):
            raise JobChangedError("The job is no longer finished.")
        context.share_links.remove_of_job(job.id)
        context.cancel_computations(job.id)
        context.storage.remove_job(job.id)
    context.quotas.job_gone(job.id, job.owner)


@router.post("/{job_id}/cancel", status_code=202, operation_id="cancelJob", summary="Cancel a job")
def cancel_job(caller: Submitter, job: VisibleJob, context: Context) -> Job:
    """Stop a job. Its finished frames are kept; they can be fetched, and it can be resumed."""
    if job.state is not JobState.CANCELLED:
        check_allowed(job, "cancel")
        context.queue.cancel(job.id)
        context.quotas.invalidate(job.owner)
    return to_job(find_job(job.id, caller, context), context)


@router.post("/{job_id}/next", operation_id="putJobFirst", summary="Put a job first")
def put_job_first(caller: Submitter, job: VisibleJob, context: Context) -> Job:
    """Move a queued job ahead of all others of its owner; jobs of others keep their places."""
    check_allowed(job, "next")
    context.queue.put_first(job.id)
    return to_job(find_job(job.id, caller, context), context)


@router.post("/{job_id}/resume", status_code=202, operation_id="resumeJob", summary="Resume a job")
def resume_job(caller: Submitter, job: VisibleJob, context: Context) -> Job:
    """Continue a failed, cancelled or timed out job from its last frame."""
    check_allowed(job, "resume")
    with context.mesh_locks.holding(job.spec.meshes):
        check_meshes(job.spec, context)
        with context.quotas.letting_in_jobs(job.owner, needed_bytes=_left_to_fill(job, context)):
            context.queue.resume(job.id)
    context.quotas.job_gone(job.id, job.owner)
    return to_job(find_job(job.id, caller, context), context)


@router.post(
    "/{job_id}/fork",
    status_code=202,
    operation_id="forkJob",
    summary="Fork a job",
    responses={
        200: {"model": Job, "description": "The job already made with this Idempotency-Key."}
    },
)
async def fork_job(
    caller: Submitter,
    job: VisibleJob,
    context: Context,
    body: Annotated[ForkRequest, Body(openapi_examples=FORK_EXAMPLES)],
    response: Response,
    idempotency_key: IdempotencyKey = None,
) -> Job:
    """Queue a job that takes the first frames of this one and continues with other settings.

    It starts from the full state after the last of these frames. The latest state is kept until
    the job has succeeded, others if it was submitted with `states_every`. With the same settings,
    its positions are bit for bit those of this job, on a CPU.
    """
    await anyio.to_thread.run_sync(fetch, job, context)
    record, new = await context.compute(fork, job, body, idempotency_key, caller, context)
    accept(response, f"/v1/jobs/{record.id}", new=new)
    return await anyio.to_thread.run_sync(to_job, record, context)


@router.post("/{job_id}/retry", status_code=202, operation_id="retryJob", summary="Retry a job")
def retry_job(caller: Submitter, job: VisibleJob, context: Context) -> Job:
    """Compute a finished job again from the beginning; its old output is deleted."""
    check_allowed(job, "retry")
    if job.spec.fork:
        raise ProblemError(
            409,
            "A fork cannot start from the beginning: its first frames belong to another job.",
            f"Fork job {job.spec.fork.job} again.",
        )
    with context.mesh_locks.holding(job.spec.meshes):
        check_meshes(job.spec, context)
        with context.quotas.letting_in_jobs(job.owner, needed_bytes=_left_to_fill(job, context)):
            context.cancel_computations(job.id)
            context.queue.retry(job.id)
    context.quotas.job_gone(job.id, job.owner)
    return to_job(find_job(job.id, caller, context), context)


def _left_to_fill(job: JobRecord, context: ServerContext) -> int:
    """Disk that a finished job is expected to fill in addition, once it goes on [bytes]."""
    return max(int(job.attributes.get(DISK_BYTES, 0)) - context.storage.job_bytes(job.id), 0)


def accept(response: Response, path: str, *, new: bool) -> None:
    """Tell where to find what was queued, by this request or by an earlier one of the same key."""
    response.status_code = 202 if new else 200
    response.headers["Location"] = path
    response.headers["Retry-After"] = RETRY_AFTER


def _submit(
    body: JobRequest, key: str | None, caller: Caller, context: ServerContext
) -> tuple[Job, bool]:
    job_id = idempotent_id("job", caller, key) if key else new_id()
    if key and (known := context.queue.get(job_id)):  # whose meshes may have been deleted since
        if known.attributes.get("body") != request_digest(body):
            raise idempotency_conflict()
        return to_job(known, context), False
    submission = prepare(body, caller, context)
    with context.quotas.letting_in_jobs(caller.name, needed_bytes=submission.disk_bytes):
        record, new = submit(submission, job_id=job_id, caller=caller, context=context)
    return to_job(record, context), new


async def _receive_form(
    request: Request, caller: Caller, context: ServerContext, stack: AsyncExitStack
) -> tuple[JobRequest, list[str]]:
    """The request in a form, its files stored, and the ids of those that the caller had not before.

    Nothing is kept if any part of it is wrong.
    """
    settings = context.settings
    incoming = await enter_in_thread(stack, context.quotas.letting_in_meshes(caller.name, 0))
    form = await stack.enter_async_context(receive_form(request, settings.body_bytes, incoming.add))
    files = {role: form[role] for role in ("source", "target") if role in form}
    if form.keys() - files.keys() != {"job"}:
        raise ProblemError(
            422,
            "The form may have only the parts `job`, `source` and `target`.",
            "Put the JSON in `job` and the files in `source` and `target`.",
        )
    body = load_json(await _text(form["job"], settings.body_bytes))
    if not isinstance(body, dict) or body.keys() & files.keys():
        raise ProblemError(
            422,
            "The part `job` is not a JSON object, or names a shape that is also sent as a file.",
            "Omit shapes that are sent as files.",
        )
    uploads = {}
    for role, file in files.items():
        if not isinstance(file, UploadFile):
            raise ProblemError(
                422, f"The part `{role}` is not a file.", "Send it as a file, with a file name."
            )
        folder, name = context.storage.uploads, file.filename or ""
        uploads[role] = await stack.enter_async_context(
            save_upload(read_blocks(file), folder, name, settings.upload_bytes, count=None)
        )
    shapes = {role: {"mesh": upload.sha256} for role, upload in uploads.items()}
    job = validate(body | shapes, JobRequest)
    if not uploads:
        return job, []
    letting_in = context.quotas.letting_in_meshes(caller.name, len(uploads))
    meshes = await enter_in_thread(stack, letting_in)
    stored = await store_uploads(list(uploads.values()), meshes, request, caller, context)
    return job, [row.sha256 for row, new in stored if new]


async def _text(part: UploadFile | str, max_bytes: int) -> bytes | str:
    """A part of a form that is short, also where it was sent as a file."""
    if isinstance(part, str):
        return part
    if part.size is None or part.size > max_bytes:
        raise too_large(max_bytes)
    return await part.read()
