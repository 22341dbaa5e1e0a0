"""/v1/jobs/{id}/exports: results in the formats of other programs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import anyio
from fastapi import APIRouter, Request, Response
from starlette.responses import FileResponse

from chamfer_morph.schemas import Export, ExportFormat, ExportRequest
from chamfer_morph.schemas.ids import derived_id, is_id
from chamfer_morph.server.auth import Reader, Submitter
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.database.api_keys import Caller
from chamfer_morph.server.http.array_encoding import BINARY
from chamfer_morph.server.http.conditional import etag_headers, not_modified
from chamfer_morph.server.http.json_body import read_json
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.routes import job_lookup, job_view
from chamfer_morph.server.submission import body_digest
from chamfer_morph.worker.frame_reader import count_frames
from chamfer_morph.worker.queue import JobRecord
from chamfer_morph.worker.tasks.make_export import KeptExport, Order, make_export

router = APIRouter(tags=["exports"])

RETRY_AFTER = "1"

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
    record, result = await anyio.to_thread.run_sync(_find_result, job_id, caller, context)
    order = await anyio.to_thread.run_sync(_order, wanted, record, result)
    folder = context.storage.exports_dir(job_id)
    kept = await anyio.to_thread.run_sync(KeptExport.find, folder, order.id)
    if kept is None:
        await anyio.to_thread.run_sync(context.quotas.check_disk, record.owner)
        available = partial(context.quotas.available_bytes, record.owner)
        make = partial(make_export, context.storage, job_id, order, context.settings, available)
        context.exports.start(folder / order.id, record.owner, make)
    response.status_code = 200 if kept else 202
    response.headers["Location"] = f"/v1/jobs/{job_id}/exports/{order.id}"
    response.headers["Retry-After"] = RETRY_AFTER
    return _show(job_id, order.id, context)[0]


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
    _, kept = await anyio.to_thread.run_sync(_show, job_id, export_id, context)
    folder = context.storage.exports_dir(job_id)
    context.exports.end(folder / export_id)
    if kept is not None:
        await anyio.to_thread.run_sync(kept.remove, folder, export_id)
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
    shown, kept = _show(job_id, export_id, context)
    if kept is None:
        if shown.problem is not None:
            raise ProblemError(409, shown.problem.cause, shown.problem.remedy)
        raise ProblemError(
            409, "The export is not ready.", "Ask again soon.", headers={"Retry-After": RETRY_AFTER}
        )
    path = context.storage.exports_dir(job_id) / kept.file
    headers = etag_headers(kept.sha256)
    return not_modified(request, headers) or FileResponse(
        path, headers=headers, media_type=kept.media_type, filename=kept.name
    )


def _find_result(job_id: str, caller: Caller, context: ServerContext) -> tuple[JobRecord, Path]:
    """A finished job and its result file."""
    record = job_lookup.find_job(job_id, caller, context)
    return record, job_lookup.find_result(record, context)


def _order(wanted: ExportRequest, record: JobRecord, result: Path) -> Order:
    """What to make, under an id that follows from the request and the result.

    Raises:
        ProblemError: 422, there is no such frame.
        ConfigError: There is no such format or field, or it cannot hold what is asked for.
    """
    from morph_engine.export import check

    check(wanted.format, surface=wanted.surface, fields=wanted.fields)
    count = count_frames(result, finished=True)
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
    return Order(id=derived_id(f"export\0{digest}"), name=name, **what)


def _show(job_id: str, export_id: str, context: ServerContext) -> tuple[Export, KeptExport | None]:
    """An export as the API shows it, and its file once it is ready.

    Raises:
        ProblemError: 404.
    """
    folder = context.storage.exports_dir(job_id)
    here = f"/v1/jobs/{job_id}/exports/{export_id}"
    known = is_id(export_id)
    # what ends between the two looks is found by the second
    task = context.exports.get(folder / export_id) if known else None
    kept = KeptExport.find(folder, export_id) if known else None
    if kept is not None:
        export = Export(
            id=export_id, job=job_id, state="ready", progress=1.0, problem=None,
            file_name=kept.name, size=kept.size_bytes,
            links={"self": here, "file": f"{here}/file"},
        )  # fmt: skip
        return export, kept
    if task is None:
        raise ProblemError(
            404,
            f"There is no export {export_id[:80]!r} of this job.",
            "Ask for it again with POST.",
        )
    export = Export(
        id=export_id, job=job_id, state="failed" if task.problem else "running",
        progress=task.progress, problem=task.problem, file_name=None, size=None,
        links={"self": here},
    )  # fmt: skip
    return export, None
