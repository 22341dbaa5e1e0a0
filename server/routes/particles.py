"""/v1/meshes/{id}/particles and /v1/shapes/{name}/particles: a shape filled, before any job."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated

import anyio
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from chamfer_morph.schemas import Fit, FrameFormat
from chamfer_morph.server.auth import AuthenticatedRoute, Reader
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http import array_encoding
from chamfer_morph.server.routes import meshes
from morph_engine.sections import GridConfig

router: APIRouter = APIRouter(route_class=AuthenticatedRoute)

EXTENT = GridConfig().half_extent
"""Half edge of the usual domain [grid units]."""

RESPONSES = array_encoding.array_responses(
    "Positions of all particles.",
    {
        "Morph-Count": ("integer", "Number of particles."),
        "Morph-Warnings": ("string", "What to know of the shape: a JSON list of sentences."),
    },
)


class Sampling(BaseModel):
    """How to fill a shape with particles."""

    points_per_cell_edge: int = Field(
        3, ge=1, le=8, description="Lattice points per grid unit and axis."
    )
    fit: Fit = Field("auto", description="How to place it; `auto` scales only what does not fit.")
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
    """The particles that a job would fill the mesh with, encoded as frames are."""
    row, path = await anyio.to_thread.run_sync(meshes.find_mesh, mesh_id, caller, context)
    report = context.storage.mesh_report(mesh_id) or {}
    warnings = report.get("warnings", [])
    return await _particles(path, row.name, warnings, sampling, request, context)


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
    """The particles that a job would fill the shape with; `text:WORD` is one, too."""
    return await _particles(shape, shape, [], sampling, request, context)


async def _particles(
    shape: Path | str,
    name: str,
    warnings: list[str],
    sampling: Sampling,
    request: Request,
    context: ServerContext,
) -> Response:
    per_edge, fit = sampling.points_per_cell_edge, sampling.fit
    compute = partial(context.sandbox.sample_shape, shape, name, per_edge, fit)
    sample = await context.previews.get((shape, per_edge, fit), compute, request)
    headers = {
        "Morph-Count": str(len(sample.positions)),
        "Morph-Warnings": json.dumps([*warnings, *sample.warnings]),
    }
    return await anyio.to_thread.run_sync(
        array_encoding.array_response, request, sample.positions, sampling.format, EXTENT, headers
    )
