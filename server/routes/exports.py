"""/v1/jobs/{id}/exports: results in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import anyio
from fastapi import APIRouter, Request, Response
from starlette.responses import FileResponse

from chamfer_morph.schemas import Export, ExportFormat, ExportRequest, Problem
from chamfer_morph.schemas.ids import derived_id, is_id
from chamfer_morph.server.auth import Reader, Submitter
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.array_encoding import BINARY
from chamfer_morph.server.http.conditional import etag_headers, not_modified
from chamfer_morph.server.http.json_body import read_json
from chamfer_morph.server.http.problems import ProblemError, as_problem
from chamfer_morph.server.routes import job_lookup, job_view
from chamfer_morph.server.single_flight import Flight
from chamfer_morph.server.submission import body_digest
from chamfer_morph.worker.frame_reader import count_frames
from chamfer_morph.worker.job import problem_of
from chamfer_morph.worker.queue import JobRecord
from chamfer_morph.worker.sandbox.computations import make_export
from chamfer_morph.worker.sandbox.derived_files import ExportOptions, StoredExport
from morph_engine.errors import MorphError

router = APIRouter(tags=["exports"])

RETRY_AFTER = "1"

MOST_PER_KEY = 20
"""Exports of a key that may be under way or waiting for their turn."""

FILES = {
    media_type: BINARY
    for media_type in (
        "application/octet-stream",
        "application/zip",
        "image/gif",
        "model/gltf-binary",
        "model/obj",
        "model/stl",
        "model/vnd.usd",
        "text/csv",
        "video/mp4",
    )
}
"""What `morph_engine.export.FORMATS` names, which takes a second to import."""

EXAMPLES: dict[str, Any] = {
    "surface": {
        "summary": "The surface of the last frame for Blender",
        "value": {"format": "glb", "frames": [-1], "surface": True},
    },
    "animation": {
        "summary": "All frames as points with their density, in grid units",
        "value": {"format": "ply", "fields": ["density"], "units": "grid"},
    },
}

BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": "#/components/schemas/ExportRequest"},
                "examples": EXAMPLES,
            }
        },
    }
}


@router.get("/exports/formats", operation_id="listExportFormats", summary="List export formats")
def list_formats(caller: Reader) -> list[ExportFormat]:
    """What frames can be written as, and what each format holds."""
    from morph_engine.export import FORMATS

    return [
        ExportFormat(
            name=format.name,
            suffix=format.suffix,
            media_type=format.media_type,
            kind=format.kind,
            carries=sorted(format.carries),
            extra=format.extra,
            description=format.description,
        )
        for format in FORMATS.values()
    ]


@router.post(
    "/jobs/{job_id}/exports",
    status_code=202,
    operation_id="exportJob",
    summary="Export a job",
    responses={200: {"model": Export, "description": "It is there already."}},
    openapi_extra=BODY,
)
async def export_job(
    job_id: str, request: Request, response: Response, caller: Submitter, context: Context
) -> Export:
    """Have frames of a finished job written in another format. The same request is one export.

    Several frames in a format that holds one frame a file make a zip archive.
    """
    wanted = await read_json(request, ExportRequest, context.settings)
    record = await anyio.to_thread.run_sync(job_lookup.find_job, job_id, caller, context)
    result = await job_lookup.find_result(record, request, context)
    options = await anyio.to_thread.run_sync(_options, wanted, record, result)
    folder = context.storage.exports_dir(job_id)
    stored = await anyio.to_thread.run_sync(StoredExport.find, folder, options.id)
    if stored is None:
        await anyio.to_thread.run_sync(context.quotas.check_disk, record.owner)
        _start(options, record, context)
    response.status_code = 200 if stored else 202
    response.headers["Location"] = f"/v1/jobs/{job_id}/exports/{options.id}"
    response.headers["Retry-After"] = RETRY_AFTER
    return _show(job_id, options.id, context)[0]


@router.get(
    "/jobs/{job_id}/exports/{export_id}", operation_id="getExport", summary="Show an export"
)
def get_export(job_id: str, export_id: str, caller: Reader, context: Context) -> Export:
    """How far an export has come.

    One that was under way when the service stopped is not there any more; ask for it again.
    """
    job_lookup.find_job(job_id, caller, context)
    return _show(job_id, export_id, context)[0]


@router.delete(
    "/jobs/{job_id}/exports/{export_id}",
    status_code=204,
    operation_id="deleteExport",
    summary="Delete an export",
)
async def delete_export(job_id: str, export_id: str, caller: Submitter, context: Context) -> None:
    """End an export that is under way, or remove its file."""
    record = await anyio.to_thread.run_sync(job_lookup.find_job, job_id, caller, context)
    _, stored = await anyio.to_thread.run_sync(_show, job_id, export_id, context)
    folder = context.storage.exports_dir(job_id)
    context.exports.cancel(job_id, export_id)
    if stored is not None:
        await anyio.to_thread.run_sync(stored.remove, folder, export_id)
        context.quotas.invalidate(record.owner)


@router.get(
    "/jobs/{job_id}/exports/{export_id}/file",
    operation_id="getExportFile",
    summary="Download an export",
    response_class=FileResponse,
    responses={
        200: {"content": FILES, "description": "The file."},
        206: {"content": FILES, "description": "The part asked for with Range."},
        304: {"description": "You have it already."},
    },
)
def get_export_file(
    job_id: str, export_id: str, request: Request, caller: Reader, context: Context
) -> Response:
    """The file of an export that is ready; its ETag is its SHA-256.

    Understands Range, If-Range and If-None-Match.
    """
    job_lookup.find_job(job_id, caller, context)
    shown, stored = _show(job_id, export_id, context)
    if stored is None:
        if shown.problem is not None:
            raise ProblemError(409, shown.problem.cause, shown.problem.remedy)
        raise ProblemError(
            409, "The export is not ready.", "Ask again soon.", headers={"Retry-After": RETRY_AFTER}
        )
    path = context.storage.exports_dir(job_id) / stored.file
    headers = etag_headers(stored.sha256)
    return not_modified(request, headers) or FileResponse(
        path, headers=headers, media_type=stored.media_type, filename=stored.name
    )


def _start(options: ExportOptions, record: JobRecord, context: ServerContext) -> None:
    """Begin with an export, unless it is under way.

    Raises:
        ProblemError: 429, the key has too many.
    """
    key = (record.id, options.id)
    known = context.exports.find(key)
    running = known is not None and known.error is None
    if not running and context.exports.count(record.owner) >= MOST_PER_KEY:
        raise ProblemError(
            429,
            f"{MOST_PER_KEY} exports of this key are under way.",
            "Wait for some to finish.",
            headers={"Retry-After": "10"},
        )

    def compute(flight: Flight[None]) -> None:
        make_export(
            context.storage,
            record.id,
            options,
            context.settings,
            file_bytes=context.quotas.available_bytes(record.owner),
            on_start=flight.on_start,
            on_progress=flight.on_progress,
        )

    context.exports.start(key, compute, record.owner)


def _options(wanted: ExportRequest, record: JobRecord, result: Path) -> ExportOptions:
    """What to make, under an id that follows from the request and the result.

    Raises:
        ProblemError: 422, there is no such frame.
        ConfigError: There is no such format or field, or it cannot hold what is asked for.
    """
    from morph_engine.export import check

    check(wanted.format, surface=wanted.surface, fields=wanted.fields)
    count = count_frames(result)
    for frame in wanted.frames or ():
        if not -count <= frame < count:
            raise ProblemError(
                422, f"There is no frame {frame}.", f"The {count} frames count from 0."
            )
    frames = wanted.frames and [frame % count for frame in dict.fromkeys(wanted.frames)]
    seen = result.stat()
    what = wanted.model_dump(mode="json") | {"frames": frames}
    digest = body_digest(what | {"result": [seen.st_mtime_ns, seen.st_size]})
    name = job_view.file_stem(record)
    if frames and len(frames) == 1:
        name += f"-{frames[0]}"
    return ExportOptions(id=derived_id(f"export\0{digest}"), name=name, **what)


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
        export = Export(
            id=export_id, job=job_id, state="ready", progress=1.0, problem=None,
            file_name=stored.name, size=stored.size_bytes,
            links={"self": here, "file": f"{here}/file"},
        )  # fmt: skip
        return export, stored
    if flight is None:
        raise ProblemError(
            404,
            f"There is no export {export_id[:80]!r} of this job.",
            "Ask for it again with POST.",
        )
    problem = _problem(flight.error) if flight.error else None
    export = Export(
        id=export_id, job=job_id, state="failed" if problem else "running",
        progress=flight.progress, problem=problem, file_name=None, size=None,
        links={"self": here},
    )  # fmt: skip
    return export, None


def _problem(error: Exception) -> Problem:
    """Why an export has failed."""
    if isinstance(error, MorphError):
        return problem_of(error)
    told = as_problem(error)
    kind: Literal["resources", "internal"] = "resources" if told.status < 500 else "internal"
    return Problem(cause=told.detail, remedy=told.remedy, kind=kind)
