"""/v1/jobs/{id}/frames/{index}/surface: a closed mesh around the particles of a frame."""

from __future__ import annotations

import io
from functools import partial
from typing import Annotated, Any

import anyio
import numpy as np
from fastapi import APIRouter, Query, Request, Response

from chamfer_morph.schemas import SurfaceFormat, Units
from chamfer_morph.server.auth import AuthenticatedRoute
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.array_encoding import PLY
from chamfer_morph.server.http.conditional import binary_responses, etag_headers, not_modified
from chamfer_morph.server.http.problems import not_found
from chamfer_morph.server.routes.job_lookup import FinishedFrame, VisibleJob
from chamfer_morph.worker.frame_reader import read_transform
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.sandbox.derived_files import StoredSurface

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}", tags=["results"], route_class=AuthenticatedRoute
)

MEDIA_TYPES: dict[SurfaceFormat, str] = {
    "glb": "model/gltf-binary", "ply": PLY, "obj": "model/obj", "stl": "model/stl",
}  # fmt: skip

HEADERS: dict[str, tuple[str, str]] = {
    "Morph-Frame": ("integer", "Index of the frame."),
    "Morph-Watertight": ("boolean", "Whether every edge joins two faces of the same orientation."),
    "Morph-Bodies": ("integer", "Parts that share no vertex; an inner cavity counts as one."),
    "Morph-Largest": ("number", "Share of the area that belongs to the largest part."),
    "Morph-Deviation-Mean": ("number", "Mean distance to the target mesh [grid units]."),
    "Morph-Deviation-Max": ("number", "Largest distance to the target mesh [grid units]."),
}


@router.get(
    "/frames/{index}/surface",
    operation_id="getSurface",
    summary="The surface of a frame",
    response_class=Response,
    responses=binary_responses("A triangle mesh.", MEDIA_TYPES.values(), HEADERS),
)
async def get_surface(
    job: VisibleJob,
    frame: FinishedFrame,
    request: Request,
    context: Context,
    format: Annotated[SurfaceFormat, Query(description="Format of the file.")] = "glb",
    units: Annotated[
        Units, Query(description="As for exports, but the default is `grid`.")
    ] = "grid",
    snap: Annotated[
        bool, Query(description="Snap it onto the meshes in the first and last frames.")
    ] = False,
) -> Response:
    """A closed and smooth mesh around the particles of a finished frame, also while the job runs.

    It is computed on the first request, which takes seconds, and kept with the job. The headers
    tell whether it is closed and how far it is from the target mesh, which is that of the unsnapped
    surface. Once the job has ended, GLB, PLY and OBJ have the colours of the shapes, if any, and
    the surface can be snapped onto their meshes.
    """
    path = context.storage.surface_path(job.id, frame.index)
    result = context.storage.result_path(job.id)
    if not await anyio.to_thread.run_sync(StoredSurface.is_there, path, result):
        compute = partial(context.sandbox.reconstruct_surface, job.id, frame.index)
        await anyio.to_thread.run_sync(context.quotas.check_disk, job.owner)
        await context.surfaces.get((job.id, frame.index), compute, request, job.owner)
        await anyio.to_thread.run_sync(context.quotas.job_changed, job.id, job.owner)
    try:
        stat = await anyio.Path(path).stat()
        headers = etag_headers(f"{stat.st_mtime_ns:x}-{stat.st_size:x}-{format}-{units}-{snap:d}")
        if answer := not_modified(request, headers):
            return answer
        wanted = job, frame.index, format, units, snap
        body, report = await context.compute(_encode, *wanted, context)
    except FileNotFoundError:  # deleted meanwhile
        raise not_found("job", job.id) from None
    return Response(body, headers=headers | report, media_type=MEDIA_TYPES[format])


def _encode(
    job: JobRecord,
    index: int,
    format: SurfaceFormat,
    units: Units,
    snap: bool,
    context: ServerContext,
) -> tuple[bytes, dict[str, str]]:
    """A surface that is there as a file, and headers that describe it."""
    import trimesh

    from morph_engine.export import glb
    from morph_engine.results.selection import Snapshot

    surface = StoredSurface.load(context.storage.surface_path(job.id, index))
    vertices = surface.snapped if snap and surface.snapped is not None else surface.vertices
    mesh = trimesh.Trimesh(vertices, surface.faces, process=False)
    if units != "grid":
        mesh.apply_transform(read_transform(context.storage.result_path(job.id), index, units))
    file = io.BytesIO()
    if format == "glb" and surface.colors is not None:
        vertices = np.asarray(mesh.vertices)
        file.write(glb.to_bytes(Snapshot(index, vertices, surface.faces, {}, 0.0, surface.colors)))
    else:
        if surface.colors is not None:
            mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=surface.colors)
        normals = {"include_normals": True} if format == "glb" else {}
        mesh.export(file, file_type=format, **normals)
    headers: dict[str, Any] = {
        "Morph-Frame": index,
        "Morph-Watertight": str(surface.report["watertight"]).lower(),
        "Morph-Bodies": surface.report["bodies"],
        "Morph-Largest": round(surface.report["largest"], 6),
    }
    if deviation := surface.report.get("deviation"):
        headers["Morph-Deviation-Mean"] = round(deviation["mean"], 6)
        headers["Morph-Deviation-Max"] = round(deviation["max"], 6)
    return file.getvalue(), {name: str(value) for name, value in headers.items()}
