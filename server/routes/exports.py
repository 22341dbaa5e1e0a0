"""/v1/jobs/{id}/exports: results in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import anyio
from fastapi import APIRouter, Body, Request, Response
from fastapi.openapi.models import Example
from starlette.responses import FileResponse

from chamfer_morph.schemas import Export, ExportFormat, ExportRequest, Problem
from chamfer_morph.schemas.ids import derived_id, is_id
from chamfer_morph.server.auth import AuthenticatedRoute, Reader, Submitter
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.conditional import binary_responses, file_response
from chamfer_morph.server.http.problems import ProblemError, as_problem
from chamfer_morph.server.routes.job_lookup import VisibleJob, find_result
from chamfer_morph.server.routes.job_view import file_stem
from chamfer_morph.server.single_flight import Flight
from chamfer_morph.server.submission import body_digest
from chamfer_morph.worker.frame_reader import count_frames
from chamfer_morph.worker.job import problem_of
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.sandbox.derived_files import ExportOptions, StoredExport
from morph_engine.errors import DamagedError, MorphError

router: APIRouter = APIRouter(tags=["exports"], route_class=AuthenticatedRoute)

RETRY_AFTER = "1"

MOST_PER_KEY = 20
"""Exports of a key that may be under way or waiting for their turn."""

MEDIA_TYPES = (
    "application/octet-stream",
    "application/zip",
    "image/gif",
    "model/gltf-binary",
    "model/obj",
    "model/stl",
    "model/vnd.usd",
    "text/csv",
    "text/html",
    "video/mp4",
    "video/quicktime",
    "video/webm",
)
"""What `morph_engine.export.FORMATS` names, which takes a second to import."""

EXAMPLES: dict[str, Example] = {
    "surface": {
        "summary": "The surface of the last frame for Blender",
        "value": {"format": "glb", "frames": [-1], "surface": True},
    },
    "moving mesh": {
        "summary": "One mesh through all frames, animated",
        "value": {"format": "glb", "tracked": True, "snap": True},
    },
    "animation": {
        "summary": "All frames as points with their density, in grid units",
        "value": {"format": "ply", "fields": ["density"], "units": "grid"},
    },
    "film": {
        "summary": "A full HD video in porcelain that turns once",
        "value": {
            "format": "mp4",
            "surface": True,
            "seconds": 6,
            "hold": 0.5,
            "picture": {"width": 1920, "height": 1080, "look": "porcelain", "camera": "turn"},
        },
    },
}


@router.get("/exports/formats", operation_id="listExportFormats", summary="List export formats")
def list_formats(caller: Reader) -> list[ExportFormat]:
    """The formats that frames can be written in, and what each can hold."""
    from morph_engine.export import FORMATS

    return [
        ExportFormat.model_validate(vars(format) | {"carries": sorted(format.carries)})
        for format in FORMATS.values()
    ]


@router.post(
    "/jobs/{job_id}/exports",
    status_code=202,
    operation_id="exportJob",
    summary="Export a job",
    responses={200: {"model": Export, "description": "The export already exists."}},
)
async def export_job(
    caller: Submitter,
    job: VisibleJob,
    body: Annotated[ExportRequest, Body(openapi_examples=EXAMPLES)],
    request: Request,
    response: Response,
    context: Context,
) -> Export:
    """Write frames of a finished job in another format. The same request is the same export.

    Several frames in a format with one frame per file are put into a zip archive.
    """
    result = await find_result(job, request, context)
    options = await anyio.to_thread.run_sync(_options, body, job, result)
    folder = context.storage.exports_dir(job.id)
    stored = await anyio.to_thread.run_sync(StoredExport.find, folder, options.id)
    if stored is None:
        await anyio.to_thread.run_sync(context.quotas.check_disk, job.owner)
        _start(options, job, context)
    response.status_code = 200 if stored else 202
    response.headers["Location"] = f"/v1/jobs/{job.id}/exports/{options.id}"
    response.headers["Retry-After"] = RETRY_AFTER
    return _show(job.id, options.id, context)[0]


@router.get(
    "/jobs/{job_id}/exports/{export_id}", operation_id="getExport", summary="Show an export"
)
def get_export(job: VisibleJob, export_id: str, context: Context) -> Export:
    """How far an export has come.

    An export that was in progress when the service stopped is gone; request it again.
    """
    return _show(job.id, export_id, context)[0]


@router.delete(
    "/jobs/{job_id}/exports/{export_id}",
    status_code=204,
    operation_id="deleteExport",
    summary="Delete an export",
)
async def delete_export(
    caller: Submitter, job: VisibleJob, export_id: str, context: Context
) -> None:
    """Stop an export that is in progress, or delete its file."""
    _, stored = await anyio.to_thread.run_sync(_show, job.id, export_id, context)
    folder = context.storage.exports_dir(job.id)
    context.exports.cancel(job.id, export_id)
    if stored is not None:
        await anyio.to_thread.run_sync(stored.remove, folder, export_id)
        await anyio.to_thread.run_sync(context.quotas.job_changed, job.id, job.owner)


@router.get(
    "/jobs/{job_id}/exports/{export_id}/file",
    operation_id="getExportFile",
    summary="Download an export",
    response_class=FileResponse,
    responses=binary_responses("The file.", MEDIA_TYPES, ranges=True),
)
def get_export_file(
    job: VisibleJob, export_id: str, request: Request, context: Context
) -> Response:
    """The file of an export that is ready; its ETag is its SHA-256.

    Supports Range, If-Range and If-None-Match.
    """
    shown, stored = _show(job.id, export_id, context)
    if stored is None:
        if shown.problem is not None:
            raise ProblemError(409, shown.problem.cause, shown.problem.remedy)
        raise ProblemError(
            409,
            "The export is not ready.",
            "Try again in a moment.",
            headers={"Retry-After": RETRY_AFTER},
        )
    path = context.storage.exports_dir(job.id) / stored.file
    return file_response(
        request, path, stored.sha256, media_type=stored.media_type, filename=stored.name
    )


def _start(options: ExportOptions, job: JobRecord, context: ServerContext) -> None:
    """Begin with an export, unless it is under way.

    Raises:
        ProblemError: 429, the key has too many.
    """
    key = (job.id, options.id)
    known = context.exports.find(key)
    running = known is not None and known.error is None
    if not running and context.exports.count(job.owner) >= MOST_PER_KEY:
        raise ProblemError(
            429,
            f"{MOST_PER_KEY} exports of this key are in progress.",
            "Wait for some to finish.",
            headers={"Retry-After": "10"},
        )

    def compute(flight: Flight[None]) -> None:
        available = context.quotas.available_bytes(job.owner)
        context.sandbox.make_export(job.id, options, available, flight)
        context.quotas.job_changed(job.id, job.owner)

    context.exports.start(key, compute, job.owner)


def _options(request: ExportRequest, job: JobRecord, result: Path) -> ExportOptions:
    """What to make, under an id that follows from the request and the result.

    Raises:
        ProblemError: 422, there is no such frame.
        ConfigError: There is no such format or field, it cannot hold what is asked for, or there is
            no surface to draw.
    """
    from morph_engine.export import check

    count = count_frames(result)
    for frame in request.frames or ():
        if not -count <= frame < count:
            raise ProblemError(
                422, f"There is no frame {frame}.", f"The {count} frames are numbered from 0."
            )
    frames = request.frames and [frame % count for frame in dict.fromkeys(request.frames)]
    stat = result.stat()
    content = request.model_dump(mode="json") | {"frames": frames}
    digest = body_digest(content | {"result": [stat.st_mtime_ns, stat.st_size]})
    name = file_stem(job)
    if frames and len(frames) == 1:
        name += f"-{frames[0]}"
    options = ExportOptions(id=derived_id(f"export\0{digest}"), name=name, **content)
    check(options.format, **options.content)
    return options


def _show(
    job_id: str, export_id: str, context: ServerContext
) -> tuple[Export, StoredExport | None]:
    """An export as the API shows it, and its file once it is ready.

    Raises:
        ProblemError: 404.
    """
    folder = context.storage.exports_dir(job_id)
    here = f"/v1/jobs/{job_id}/exports/{export_id}"
    known = is_id(export_id)
    # what ends between the two looks is found by the second
    flight = context.exports.find((job_id, export_id)) if known else None
    stored = StoredExport.find(folder, export_id) if known else None
    if stored is not None:
        return Export(
            id=export_id, job=job_id, state="ready", progress=1.0, problem=None,
            file_name=stored.name, size=stored.size_bytes,
            links={"self": here, "file": f"{here}/file"},
        ), stored  # fmt: skip
    if flight is None:
        raise ProblemError(
            404,
            f"There is no export {export_id[:80]!r} of this job.",
            "Request it again with POST.",
        )
    problem = _problem(flight.error) if flight.error else None
    return Export(
        id=export_id, job=job_id, state="failed" if problem else "running",
        progress=flight.progress, problem=problem, file_name=None, size=None,
        links={"self": here},
    ), None  # fmt: skip


def _problem(error: Exception) -> Problem:
    """Why an export has failed."""
    if isinstance(error, MorphError) and not isinstance(error, DamagedError):
        return problem_of(error)
    problem = as_problem(error)
    return Problem(
        cause=problem.detail,
        remedy=problem.remedy,
        kind="resources" if problem.status_code < 500 else "internal",
    )
