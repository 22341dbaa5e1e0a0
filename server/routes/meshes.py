"""/v1/meshes: uploads, what the engine sees in them, deletion when unused."""

from __future__ import annotations

import re
from contextlib import AsyncExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import anyio
from fastapi import APIRouter, Query, Request, Response
from starlette.datastructures import UploadFile
from starlette.responses import FileResponse

from chamfer_morph.schemas import JobState, Mesh, MeshPage, MeshShape
from chamfer_morph.server.auth import AuthenticatedRoute, Reader, Submitter
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.database.tables import MeshRow, as_time
from chamfer_morph.server.http import cursors
from chamfer_morph.server.http.conditional import file_response
from chamfer_morph.server.http.problems import ProblemError, not_found
from chamfer_morph.server.http.request_body import media_type
from chamfer_morph.server.http.uploads import (
    Upload,
    enter_in_thread,
    plain_name,
    read_blocks,
    receive_form,
    save_upload,
)
from chamfer_morph.server.quotas import Incoming
from morph_engine.geometry.mesh import FORMATS

router: APIRouter = APIRouter(prefix="/meshes", tags=["meshes"], route_class=AuthenticatedRoute)

ARCHIVES = ("gz", "tar", "tgz", "7z", "rar", "xz")

# streamed to the disk as it comes, which FastAPI has no parameter for
UPLOAD_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/octet-stream": {"schema": {"type": "string", "format": "binary"}},
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "properties": {"file": {"type": "string", "format": "binary"}},
                }
            },
        },
    }
}


@router.post(
    "",
    status_code=201,
    operation_id="uploadMesh",
    summary="Upload a mesh",
    responses={200: {"model": Mesh, "description": "You already have this mesh."}},
    openapi_extra=UPLOAD_BODY,
)
async def upload_mesh(
    request: Request,
    response: Response,
    caller: Submitter,
    context: Context,
    name: Annotated[
        str,
        Query(
            max_length=200,
            description="File name of a raw body; its extension determines the format.",
        ),
    ] = "",
) -> Mesh:
    """Send the file as the raw body with its name in the query, or as a form with a part `file`.

    Accepted are OBJ, PLY, STL, OFF, GLB and self-contained glTF, or a ZIP archive of one with the
    files that it refers to, such as the materials and textures of an OBJ. A mesh that cannot be
    filled with particles is refused, with the reason. The same file sent again is the same mesh.
    """
    name = plain_name(name)
    async with AsyncExitStack() as stack:
        incoming = await enter_in_thread(stack, context.quotas.letting_in_meshes(caller.name))
        if media_type(request) == "multipart/form-data":
            form = await stack.enter_async_context(
                receive_form(request, context.settings.body_bytes, incoming.add)
            )
            file = form.get("file")
            if not isinstance(file, UploadFile):
                raise ProblemError(
                    422, "The form has no file in the part `file`.", "Send the mesh in that part."
                )
            chunks, name = read_blocks(file), name or file.filename or ""
            count = None  # it is counted as it comes
        else:
            mesh_suffix(name)
            chunks, count = request.stream(), incoming.add
        upload = await stack.enter_async_context(
            save_upload(chunks, context.storage.uploads, name, context.settings.upload_bytes, count)
        )
        (row, new), *_ = await store_uploads([upload], incoming, request, caller, context)
    response.headers["Location"] = f"/v1/meshes/{row.sha256}"
    response.status_code = 201 if new else 200
    return await anyio.to_thread.run_sync(to_mesh, row, context)


@router.get("", operation_id="listMeshes", summary="List meshes")
def list_meshes(
    caller: Reader, context: Context, limit: cursors.Limit = 50, cursor: cursors.Cursor = None
) -> MeshPage:
    """Your uploads, the newest first; everybody's for an admin key."""
    before = cursors.decode_cursor(cursor)
    rows = context.meshes.page(caller.owner_filter, before=before, limit=limit + 1)
    page, more = rows[:limit], len(rows) > limit
    return MeshPage(
        items=[mesh for row in page if (mesh := _to_mesh_or_none(row, context))],
        next_cursor=cursors.encode_cursor(page[-1].created_at, page[-1].sha256) if more else None,
    )


@router.get("/{mesh_id}", operation_id="getMesh", summary="Describe a mesh")
def get_mesh(mesh_id: str, caller: Reader, context: Context) -> Mesh:
    """Properties of a mesh: whether it is closed, volume, particles, expected time and memory."""
    return to_mesh(find_mesh(mesh_id, caller, context)[0], context)


@router.get(
    "/{mesh_id}/file",
    operation_id="getMeshFile",
    summary="Download a mesh",
    response_class=FileResponse,
    responses={304: {"description": "Not modified."}},
)
def get_mesh_file(mesh_id: str, request: Request, caller: Reader, context: Context) -> Response:
    """The file as it was uploaded; supports Range and If-None-Match."""
    row, path = find_mesh(mesh_id, caller, context)
    return file_response(
        request,
        path,
        mesh_id,
        media_type="application/octet-stream",
        filename=row.name,
        cache_control="private, max-age=31536000, immutable",
    )


@router.delete(
    "/{mesh_id}", status_code=204, operation_id="deleteMesh", summary="Delete an unused mesh"
)
def delete_mesh(mesh_id: str, caller: Submitter, context: Context) -> None:
    """Delete your upload of a mesh; with an admin key that has no upload of it, everybody's.

    Refused while a job that is not finished uses it.
    """
    find_mesh(mesh_id, caller, context)
    with context.mesh_locks.holding([mesh_id]):
        _delete(mesh_id, caller, context)
    context.quotas.invalidate(caller.name)


def discard_meshes(mesh_ids: list[str], caller: Caller, context: ServerContext) -> None:
    """Delete uploads of the caller's that nothing came of, unless a job uses them by now."""
    for mesh_id in mesh_ids:
        with suppress(ProblemError), context.mesh_locks.holding([mesh_id]):
            _delete(mesh_id, caller, context)
    context.quotas.invalidate(caller.name)


def find_mesh(mesh_id: str, caller: Caller, context: ServerContext) -> tuple[MeshRow, Path]:
    """An upload that the caller may see, and its file.

    Raises:
        ProblemError: 404.
    """
    known = re.fullmatch("[0-9a-f]{64}", mesh_id)
    row = context.meshes.get(caller.owner_filter, mesh_id) if known else None
    path = context.storage.mesh_file(mesh_id) if row else None
    if row is None or path is None:
        raise not_found("mesh", mesh_id)
    return row, path


async def store_uploads(
    uploads: list[Upload],
    incoming: Incoming,
    request: Request,
    caller: Caller,
    context: ServerContext,
) -> list[tuple[MeshRow, bool]]:
    """Inspect uploads, and store them if all can be used.

    Args:
        uploads: What has come.
        incoming: As what it counts until then.
        request: The request, whose end ends the inspection.
        caller: Whose they are.
        context: The service.

    Returns:
        Each upload, and whether its owner did not have it before.

    Raises:
        ProblemError: 415, a name without the suffix of a mesh format; or a limit of the key.
        MorphError: One cannot be used.
    """
    reports: list[dict[str, Any] | None] = []
    for upload in uploads:
        mesh_suffix(upload.name)  # refuses what has none
        report = None
        if not await anyio.to_thread.run_sync(_is_stored, upload.sha256, context):
            inspect = partial(context.sandbox.inspect_mesh, upload.path, upload.name)
            report = await context.inspections.get((upload.path,), inspect, request, caller.name)
        reports.append(report)
    await anyio.to_thread.run_sync(incoming.keep_place)
    return [
        await anyio.to_thread.run_sync(_store, upload, report, caller, context)
        for upload, report in zip(uploads, reports, strict=True)
    ]


def mesh_suffix(name: str) -> str:
    """The mesh format that a file name tells.

    Raises:
        ProblemError: 415.
    """
    suffix = Path(name).suffix[1:].lower()
    if suffix in FORMATS:
        return suffix
    if not name:
        raise ProblemError(
            415,
            "The format of the mesh is unknown without a file name.",
            "Add one, as in ?name=bunny.obj.",
        )
    verb = "Unpack it, and send" if suffix in ARCHIVES else "Export it as"
    raise ProblemError(
        415, f"{name!r} is not in a known mesh format.", f"{verb} OBJ, PLY, STL, OFF or GLB."
    )


def to_mesh(row: MeshRow, context: ServerContext) -> Mesh:
    """An upload as the API shows it.

    Raises:
        ProblemError: 404, it has gone, or its report cannot be read.
    """
    mesh = _to_mesh_or_none(row, context)
    if mesh is None:
        raise not_found("mesh", row.sha256)
    return mesh


def _to_mesh_or_none(row: MeshRow, context: ServerContext) -> Mesh | None:
    if context.storage.mesh_file(row.sha256) is None:
        return None
    report = context.storage.mesh_report(row.sha256)
    if report is None:
        return None
    return Mesh(
        id=row.sha256,
        name=row.name,
        size_bytes=row.size_bytes,
        created_at=as_time(row.created_at),
        report=report | {"name": row.name},
    )


def _store(
    upload: Upload, report: dict[str, Any] | None, caller: Caller, context: ServerContext
) -> tuple[MeshRow, bool]:
    known = context.meshes.get(caller.name, upload.sha256) is not None
    with (
        context.mesh_locks.holding([upload.sha256]),
        context.quotas.storing_mesh(caller.name, 0 if known else upload.size_bytes),
    ):
        if report is not None:
            suffix = mesh_suffix(upload.name)
            context.storage.add_mesh(upload.path, upload.sha256, suffix, report)
        elif not _is_stored(upload.sha256, context):  # it was when it was looked at
            raise _deleted_meanwhile()
        new = context.meshes.add(caller.name, upload.sha256, upload.name, upload.size_bytes)
    row = context.meshes.get(caller.name, upload.sha256)
    if row is None:
        raise _deleted_meanwhile()
    return row, new


def _is_stored(sha256: str, context: ServerContext) -> bool:
    """Whether somebody has a mesh; a host may still have a copy of one that was deleted."""
    known = context.meshes.get(None, sha256) is not None
    return known and context.storage.mesh_file(sha256) is not None


def _deleted_meanwhile() -> ProblemError:
    return ProblemError(409, "The mesh has been deleted in the meantime.", "Upload it again.")


def _delete(mesh_id: str, caller: Caller, context: ServerContext) -> None:
    """Forget an upload, unless an unfinished job needs it; its lock is held."""
    own = context.meshes.get(caller.name, mesh_id) is not None
    users = _unfinished_users(mesh_id, context)
    visible = [job_id for job_id, owner in users if caller.can_see(owner)]
    if visible:
        raise ProblemError(
            409,
            f"{len(visible)} unfinished job(s) use this mesh, such as {visible[0]}.",
            "Wait for them, or cancel them.",
        )
    if users and context.meshes.is_sole_owner(caller.name, mesh_id):
        raise ProblemError(
            409,
            "An unfinished job of another key uses this mesh.",
            "Try again when the job has finished.",
        )
    if context.meshes.remove(caller.name if own else caller.owner_filter, mesh_id):
        context.storage.remove_mesh(mesh_id)


def _unfinished_users(mesh_id: str, context: ServerContext) -> list[tuple[str, str]]:
    """Id and owner of the unfinished jobs that use a mesh."""
    shape = MeshShape(mesh=mesh_id)
    return [
        (record.id, record.owner)
        for record in context.queue.all(states={JobState.QUEUED, JobState.RUNNING})
        if shape in record.spec.shapes
    ]
