"""/v1/jobs/{id}/colors: the colours that particles have in each shape of a morph."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from chamfer_morph.server.auth import AuthenticatedRoute
from chamfer_morph.server.context import Context
from chamfer_morph.server.http.array_encoding import BYTES
from chamfer_morph.server.http.conditional import binary_responses, bytes_response
from chamfer_morph.server.particle_colors import find_colors
from chamfer_morph.server.routes.job_lookup import VisibleJob, find_run_record

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}", tags=["results"], route_class=AuthenticatedRoute
)

HEADERS = {
    "Morph-Particles": ("integer", "Number of particles."),
    "Morph-Shapes": ("integer", "Number of shapes with colours; 0 if there are none."),
    "Morph-Reached": (
        "string",
        "Number of frames after which each of these shapes is reached, separated by commas.",
    ),
}


@router.get(
    "/colors",
    operation_id="getColors",
    summary="Colours of the particles",
    response_class=Response,
    responses=binary_responses(
        "Red, green and blue in sRGB, one byte each, particle by particle and shape by shape.",
        [BYTES],
        HEADERS,
    ),
)
async def get_colors(job: VisibleJob, request: Request, context: Context) -> Response:
    """The colours of the particles in each shape, if any shape of the morph has colours.

    After a share s of the frames between two shapes, a particle has the colour a + (3 s^2 - 2
    s^3) (b - a) of both, in linear light. While a leg of the morph is being computed, one of its
    last frames stands for its end. If no shape has colours, the body is empty.
    """
    run = await context.compute(find_run_record, job, context)
    found = await find_colors(job, run, request, context)
    headers = {
        "Morph-Particles": str(run.particle_count),
        "Morph-Shapes": str(len(found.reached) if found else 0),
        "Morph-Reached": ",".join(map(str, found.reached)) if found else "",
    }
    return bytes_response(request, found.rgb.tobytes() if found else b"", BYTES, headers)
