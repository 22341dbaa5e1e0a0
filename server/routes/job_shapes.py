"""/v1/jobs/{id}/source and /target: the points and meshes that a morph leads from and to."""

from __future__ import annotations

import io
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response

from chamfer_morph.schemas import FrameFormat
from chamfer_morph.server.auth import AuthenticatedRoute
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http import array_encoding
from chamfer_morph.server.http.conditional import binary_responses, bytes_response
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.routes.job_lookup import VisibleJob, find_run_record
from chamfer_morph.worker.job_record import JobRecord
from morph_engine.results.run_record import Role, RunRecord

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}", tags=["results"], route_class=AuthenticatedRoute
)

GLB = "model/gltf-binary"

PointFormat = Annotated[FrameFormat, Query(description="How to encode the positions.")]
Leg = Annotated[
    int | None,
    Query(
        description="For a morph through several shapes, the leg whose shape is requested, counted "
        "from 0. Default: the source of the first and the target of the last."
    ),
]
MeshFormat = Annotated[Literal["glb", "ply"], Query(description="Format of the file.")]


def _add_routes(role: Role, summary: str, description: str, points: str) -> None:
    """The endpoints of one end of the morph: its points, and its mesh.

    Args:
        role: Which end.
        summary: Of the endpoint of its points.
        description: Likewise.
        points: What the answer of that endpoint holds.
    """

    @router.get(
        f"/{role}",
        operation_id=f"get{role.title()}",
        summary=summary,
        description=description,
        response_class=Response,
        responses=array_encoding.array_responses(points),
    )
    async def get_points(
        job: VisibleJob,
        request: Request,
        context: Context,
        format: PointFormat = "f32",
        leg: Leg = None,
    ) -> Response:
        return await context.compute(_points, role, job, request, context, format, leg)

    @router.get(
        f"/{role}/mesh",
        operation_id=f"get{role.title()}Mesh",
        summary=f"The {role} as a mesh",
        description=f"The {role} mesh in grid units, as placed by the job.",
        response_class=Response,
        responses=binary_responses("The mesh in grid units.", (GLB, array_encoding.PLY)),
    )
    async def get_mesh(
        job: VisibleJob,
        request: Request,
        context: Context,
        format: MeshFormat = "glb",
        leg: Leg = None,
    ) -> Response:
        return await context.compute(_mesh, role, job, request, context, format, leg)


_add_routes(
    "source",
    "Where the particles start",
    "Particles before the first frame, in the encoding and order of frames.",
    "Positions of all particles before the first frame.",
)
_add_routes(
    "target",
    "Target points",
    "Target points, encoded like frames; there may be more or fewer than particles.",
    "Positions of all target points.",
)


def _points(
    role: Role,
    job: JobRecord,
    request: Request,
    context: ServerContext,
    format: FrameFormat,
    leg: int | None,
) -> Response:
    run = _find_leg(job, context, leg)
    positions = run.source_points if role == "source" else run.target_points
    extent = job.spec.config.grid.half_extent
    return array_encoding.array_response(request, positions, format, extent)


def _mesh(
    role: Role,
    job: JobRecord,
    request: Request,
    context: ServerContext,
    format: Literal["glb", "ply"],
    leg: int | None,
) -> Response:
    import trimesh

    mesh, _ = _find_leg(job, context, leg).fitted(role)
    if mesh is None:
        raise ProblemError(
            404, f"The {role} is a point cloud, not a mesh.", f"Request the {role} itself."
        )
    file = io.BytesIO()
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file, file_type=format)
    media_type = GLB if format == "glb" else array_encoding.PLY
    return bytes_response(request, file.getvalue(), media_type)


def _find_leg(job: JobRecord, context: ServerContext, leg: int | None) -> RunRecord:
    """The run of a job, or a leg of it.

    Raises:
        ProblemError: 404, it has no such leg.
    """
    run = find_run_record(job, context)
    if leg is None:
        return run
    if not 0 <= leg < run.leg_count:
        raise ProblemError(
            404, f"The job has no leg {leg}.", f"Its {run.leg_count} legs are numbered from 0."
        )
    return run.leg(leg)
