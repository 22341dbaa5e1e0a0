"""/v1/meshes/{id}/particles and /v1/shapes/{name}/particles: a shape filled, before any job."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import anyio
from fastapi import APIRouter, Query, Request, Response

from chamfer_morph.schemas import Fit, FrameFormat
from chamfer_morph.server.auth import Reader
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http import array_encoding
from chamfer_morph.server.http.problems import not_found
from chamfer_morph.server.routes import meshes
from chamfer_morph.server.single_flight import Flight
from chamfer_morph.worker.sandbox.computations import SampledShape, sample_shape
from morph_engine.config import GridConfig

router = APIRouter()

EXTENT = GridConfig().half_extent
"""Half edge of the usual domain [grid units]."""

Density = Annotated[int, Query(ge=1, le=8, description="Lattice points per grid unit and axis.")]
Placing = Annotated[
    Fit, Query(description="How to place it; `auto` scales only what does not fit.")
]
Format = Annotated[FrameFormat, Query(description="How to encode the positions.")]

RESPONSES = array_encoding.array_responses(
    "Positions of all particles.",
    Morph_Count=("integer", "Number of particles."),
    Morph_Warnings=("string", "What to know of the shape: a JSON list of sentences."),
)


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
    points_per_cell_edge: Density = 3,
    fit: Placing = "auto",
    format: Format = "u16",
) -> Response:
    """The particles that a job would fill the mesh with, encoded as frames are."""
    row = await anyio.to_thread.run_sync(meshes.find_mesh, mesh_id, caller, context)
    path = context.storage.mesh_file(mesh_id)
    if path is None:
        raise not_found("mesh", mesh_id)
    preview = await _sample(path, row.name, points_per_cell_edge, fit, request, context)
    known = context.storage.mesh_report(mesh_id)["warnings"]
    return await anyio.to_thread.run_sync(_response, request, preview, format, known)


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
    points_per_cell_edge: Density = 3,
    fit: Placing = "auto",
    format: Format = "u16",
) -> Response:
    """The particles that a job would fill the shape with; `text:WORD` is one, too."""
    preview = await _sample(shape, shape, points_per_cell_edge, fit, request, context)
    return await anyio.to_thread.run_sync(_response, request, preview, format, [])


async def _sample(
    shape: Path | str,
    name: str,
    points_per_cell_edge: int,
    fit: Fit,
    request: Request,
    context: ServerContext,
) -> SampledShape:
    """The particles of a shape; arguments and errors as of `sample_shape`."""

    def compute(flight: Flight[SampledShape]) -> SampledShape:
        return sample_shape(
            shape, name, points_per_cell_edge, fit, context.settings, flight.on_start
        )

    return await context.previews.get((shape, points_per_cell_edge, fit), compute, request)


def _response(
    request: Request, preview: SampledShape, format: FrameFormat, known: list[str]
) -> Response:
    headers = {
        "Morph-Count": str(len(preview.positions)),
        "Morph-Warnings": json.dumps([*known, *preview.warnings]),
    }
    return array_encoding.array_response(request, preview.positions, format, EXTENT, headers)
