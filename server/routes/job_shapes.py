"""/v1/jobs/{id}/source and /target: the points and meshes that a morph leads from and to."""

from __future__ import annotations

import io
from typing import Annotated, Any, Literal

import anyio
from fastapi import APIRouter, Query, Request, Response

from chamfer_morph.schemas import FrameFormat
from chamfer_morph.server.auth import Reader
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.database.api_keys import Caller
from chamfer_morph.server.http import array_encoding
from chamfer_morph.server.http.conditional import bytes_response
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.routes import job_lookup
from chamfer_morph.worker.frame_reader import Role, mesh_in_grid_units

router = APIRouter(prefix="/jobs/{job_id}", tags=["results"])

GLB = "model/gltf-binary"

PointFormat = Annotated[FrameFormat, Query(description="How to encode the positions.")]
MeshFormat = Annotated[Literal["glb", "ply"], Query(description="Of the file.")]

MESH: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {GLB: array_encoding.BINARY, array_encoding.PLY: array_encoding.BINARY},
        "description": "The mesh in grid units.",
    },
    304: {"description": "You have it already."},
}


@router.get(
    "/source",
    operation_id="getSource",
    summary="Where the particles start",
    response_class=Response,
    responses=array_encoding.array_responses("Positions of all particles before the first frame."),
)
async def get_source(
    job_id: str, request: Request, caller: Reader, context: Context, format: PointFormat = "f32"
) -> Response:
    """Particles before the first frame, encoded as frames are and in their order."""
    return await anyio.to_thread.run_sync(
        _points, "source", job_id, request, caller, context, format, limiter=context.compute_limiter
    )


@router.get(
    "/target",
    operation_id="getTarget",
    summary="What the particles aim at",
    response_class=Response,
    responses=array_encoding.array_responses("Positions of all target points."),
)
async def get_target(
    job_id: str, request: Request, caller: Reader, context: Context, format: PointFormat = "f32"
) -> Response:
    """Target points, encoded as frames are; their number is another than that of the particles."""
    return await anyio.to_thread.run_sync(
        _points, "target", job_id, request, caller, context, format, limiter=context.compute_limiter
    )


@router.get(
    "/source/mesh",
    operation_id="getSourceMesh",
    summary="The source as a mesh",
    response_class=Response,
    responses=MESH,
)
async def get_source_mesh(
    job_id: str, request: Request, caller: Reader, context: Context, format: MeshFormat = "glb"
) -> Response:
    """The source mesh in grid units, placed as the job has placed it."""
    return await anyio.to_thread.run_sync(
        _mesh, "source", job_id, request, caller, context, format, limiter=context.compute_limiter
    )


@router.get(
    "/target/mesh",
    operation_id="getTargetMesh",
    summary="The target as a mesh",
    response_class=Response,
    responses=MESH,
)
async def get_target_mesh(
    job_id: str, request: Request, caller: Reader, context: Context, format: MeshFormat = "glb"
) -> Response:
    """The target mesh in grid units, placed as the job has placed it."""
    return await anyio.to_thread.run_sync(
        _mesh, "target", job_id, request, caller, context, format, limiter=context.compute_limiter
    )


def _points(
    role: Role,
    job_id: str,
    request: Request,
    caller: Caller,
    context: ServerContext,
    format: FrameFormat,
) -> Response:
    record = job_lookup.find_job(job_id, caller, context)
    inputs = job_lookup.find_run_record(record, context)
    positions = inputs.source_points if role == "source" else inputs.target_points
    extent = float(record.spec.config["grid"]["half_extent"])
    return array_encoding.array_response(request, positions, format, extent, {})


def _mesh(
    role: Role,
    job_id: str,
    request: Request,
    caller: Caller,
    context: ServerContext,
    format: Literal["glb", "ply"],
) -> Response:
    import trimesh

    record = job_lookup.find_job(job_id, caller, context)
    mesh = mesh_in_grid_units(job_lookup.find_run_record(record, context), role)
    if mesh is None:
        raise ProblemError(404, f"The {role} is no mesh but points.", f"Ask for the {role} itself.")
    file = io.BytesIO()
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file, file_type=format)
    media_type = GLB if format == "glb" else array_encoding.PLY
    return bytes_response(request, file.getvalue(), media_type)
