"""/v1/meshes/{id}/particles and /v1/shapes/{name}/particles: a shape filled, before any job."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Annotated

import anyio
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field, Json

from chamfer_morph.schemas import BuiltInShape, Fit, FrameFormat, MeshShape
from chamfer_morph.server.auth import AuthenticatedRoute, Reader
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.http import array_encoding
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.routes import meshes
from chamfer_morph.server.solids import find_solid
from chamfer_morph.worker.sandbox.computations import OtherEnd
from morph_engine.results.run_record import Role
from morph_engine.sections import GridConfig, PlacementConfig

router: APIRouter = APIRouter(route_class=AuthenticatedRoute)

EXTENT = GridConfig().half_extent
"""Half edge of the usual domain [grid units]."""

Address = Annotated[str, Field(min_length=1, max_length=64)]

RESPONSES = array_encoding.array_responses(
    "Positions of all particles.",
    {
        "Morph-Count": ("integer", "Number of particles."),
        "Morph-Warnings": ("string", "Warnings about the shape: a JSON list of sentences."),
        "Morph-Placement": (
            "string",
            "What `auto` does to both shapes, as a sentence; empty if nothing.",
        ),
        "Morph-Turning": (
            "string",
            "Which shapes are turned upright, as a sentence; empty if none.",
        ),
        "Morph-Up": ("string", "The axis of the grid that points upwards: y or z."),
        "Morph-To-User": (
            "string",
            "Grid units to the shape's own coordinates: a JSON list of four rows; acts on columns.",
        ),
    },
)


class Sampling(BaseModel):
    """How to fill a shape with particles."""

    points_per_cell_edge: int = Field(
        3, ge=1, le=8, description="Lattice points per grid unit and axis."
    )
    fit: Fit = Field("auto", description="How to place it, like the setting `sampling.fit`.")
    source: Address | None = Field(
        None,
        description="The source, if the shape is a target: a shape or the id of a mesh. `auto` "
        "takes both into account.",
    )
    target: Address | None = Field(
        None,
        description="The target, if the shape is a source. Give at most one of `source` and "
        "`target`.",
    )
    placement: Json[PlacementConfig] = Field(
        PlacementConfig(),
        description="How both ends are turned, scaled and moved: the settings of `placement`, as "
        'in {"target": {"rotate": [0, 90, 0]}}.',
    )
    format: FrameFormat = Field("u16", description="How to encode the positions.")


@router.get(
    "/meshes/{mesh_id}/particles",
    operation_id="getMeshParticles",
    summary="Particles of a mesh",
    tags=["meshes"],
    response_class=Response,
    responses=RESPONSES,
)
async def get_mesh_particles(
    mesh_id: str,
    request: Request,
    caller: Reader,
    context: Context,
    sampling: Annotated[Sampling, Query()],
) -> Response:
    """The particles that a job would fill the mesh with, encoded like frames."""
    row, path = await anyio.to_thread.run_sync(meshes.find_mesh, mesh_id, caller, context)
    report = await anyio.to_thread.run_sync(context.storage.mesh_report, mesh_id) or {}
    warnings = report.get("warnings", [])
    return await _particles(path, row.name, warnings, sampling, request, caller, context)


@router.get(
    "/shapes/{shape:path}/particles",
    operation_id="getShapeParticles",
    summary="Particles of a built-in shape",
    tags=["catalog"],
    response_class=Response,
    responses=RESPONSES,
)
async def get_shape_particles(
    shape: str,
    request: Request,
    caller: Reader,
    context: Context,
    sampling: Annotated[Sampling, Query()],
) -> Response:
    """The particles that a job would fill the shape with; `text:WORD` is a shape, too."""
    return await _particles(shape, shape, [], sampling, request, caller, context)


async def _particles(
    shape: Path | str,
    name: str,
    warnings: list[str],
    sampling: Sampling,
    request: Request,
    caller: Caller,
    context: ServerContext,
) -> Response:
    other = await anyio.to_thread.run_sync(_other, sampling, caller, context)
    per_edge, fit = sampling.points_per_cell_edge, sampling.fit
    poses = sampling.placement
    compute = partial(context.sandbox.sample_shape, shape, name, per_edge, fit, other, poses)
    key = (shape, per_edge, fit, sampling.source, sampling.target, poses)
    sample = await context.previews.get(key, compute, request, caller.name)
    headers = {
        "Morph-Count": str(len(sample.positions)),
        "Morph-Warnings": json.dumps(warnings),
        "Morph-Placement": sample.message,
        "Morph-Turning": sample.turning,
        "Morph-Up": sample.up,
        "Morph-To-User": json.dumps(sample.to_user),
    }
    return await anyio.to_thread.run_sync(
        array_encoding.array_response, request, sample.positions, sampling.format, EXTENT, headers
    )


def _other(sampling: Sampling, caller: Caller, context: ServerContext) -> OtherEnd | None:
    """The other shape of the morph, if the request names one.

    Raises:
        MorphError: It cannot be found.
        ProblemError: 422, it cannot be found, or both ends are named.
    """
    if sampling.source and sampling.target:
        raise ProblemError(422, "Both source and target are given.", "Omit one of them.")
    role: Role = "source" if sampling.source else "target"
    address = sampling.source or sampling.target
    if address is None:
        return None
    is_mesh = re.fullmatch("[0-9a-f]{64}", address)
    shape = MeshShape(mesh=address) if is_mesh else BuiltInShape(shape=address)
    solid, _ = find_solid(shape, caller, context, ("query", role))
    return OtherEnd(role, solid)
