"""/v1/fields and /v1/jobs/{id}/frames/{index}/fields/{field}: numbers to colour particles by."""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

import anyio
import numpy as np
from fastapi import APIRouter, Query, Request, Response
from numpy.typing import NDArray

from chamfer_morph.schemas import ParticleField
from chamfer_morph.server.auth import AuthenticatedRoute, Reader
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.array_encoding import BYTES
from chamfer_morph.server.http.conditional import binary_responses, etag_headers, not_modified
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.routes.job_lookup import (
    FinishedFrame,
    VisibleJob,
    find_frame,
    find_run_record,
)
from chamfer_morph.worker.frame_reader import Frame, read_det_f
from chamfer_morph.worker.job_record import JobRecord

router: APIRouter = APIRouter(tags=["fields"], route_class=AuthenticatedRoute)

LEVELS = 255

ValueFormat = Literal["u8", "f32"]
HEADERS = {
    "Morph-Frame": ("integer", "Index of the frame."),
    "Morph-Particles": ("integer", "Number of values."),
    "Morph-Low": ("number", "Value of byte 0."),
    "Morph-High": ("number", "Value of byte 255."),
    "Morph-Offset": ("number", "For u8: value = Morph-Offset + Morph-Scale x byte."),
    "Morph-Scale": ("number", "For u8: value = Morph-Offset + Morph-Scale x byte."),
}

Bound = Annotated[float | None, Query(allow_inf_nan=False)]


@router.get("/fields", operation_id="listFields", summary="List fields")
def list_fields(caller: Reader) -> list[ParticleField]:
    """Quantities to colour particles by: one number for each particle and frame."""
    from morph_engine.results.fields import FIELDS

    return [ParticleField(name=name, **vars(field)) for name, field in FIELDS.items()]


@router.get(
    "/jobs/{job_id}/frames/{index}/fields/{field}",
    operation_id="getField",
    summary="One number per particle",
    response_class=Response,
    responses=binary_responses("The values, in the order of the particles.", [BYTES], HEADERS),
)
async def get_field(
    job: VisibleJob,
    frame: FinishedFrame,
    field: str,
    request: Request,
    context: Context,
    format: Annotated[ValueFormat, Query(description="How to encode the values.")] = "u8",
    low: Bound = None,
    high: Bound = None,
) -> Response:
    """A field of a finished frame, also while the job runs; /v1/fields names them.

    `u8`: a byte for each particle; value = Morph-Offset + Morph-Scale x byte, clamped to the
    range from `low` to `high`, by default that of the frame. `f32`: little-endian float32. A
    particle that has no value because it is out of all bounds is NaN in f32 and 0 in u8.
    """
    from morph_engine.results.fields import FIELDS

    if field not in FIELDS:
        raise ProblemError(
            404, f"There is no field {field[:80]!r}.", f"Fields are {', '.join(FIELDS)}."
        )
    etag = await anyio.to_thread.run_sync(_etag, frame, f"{field} {format} {low} {high}")
    headers = etag_headers(etag)
    if answer := not_modified(request, headers):
        return answer

    def encoded() -> tuple[bytes, dict[str, str]]:
        return _encode(_compute(job, frame, field, context), format, low, high)

    body, encoding = await context.compute(encoded)
    headers |= {"Morph-Frame": str(frame.index), **encoding}
    return Response(body, headers=headers, media_type=BYTES)


def _etag(frame: Frame, what: str) -> str:
    """What a field follows from: the frame, those before it, and what is asked for."""
    digest = hashlib.sha256(frame.positions.tobytes())
    digest.update(f"{frame.index} {what}".encode())
    return digest.hexdigest()


def _encode(
    values: NDArray[np.float32], format: ValueFormat, low: float | None, high: float | None
) -> tuple[bytes, dict[str, str]]:
    """Values as bytes, and the headers that tell how to read them.

    Raises:
        ProblemError: 422, the range ends before it begins.
    """
    low, high = _range(values, low, high)
    headers = {
        "Morph-Particles": str(len(values)),
        "Morph-Low": repr(low),
        "Morph-High": repr(high),
    }
    if format == "f32":
        return values.astype("<f4").tobytes(), headers
    scale = (high - low) / LEVELS
    headers |= {"Morph-Offset": repr(low), "Morph-Scale": repr(scale)}
    levels = np.nan_to_num((values.astype(np.float64) - low) / (scale or 1))
    return np.rint(levels).clip(0, LEVELS).astype(np.uint8).tobytes(), headers


def _compute(
    job: JobRecord, frame: Frame, name: str, context: ServerContext
) -> NDArray[np.float32]:
    from morph_engine.results.fields import field

    run = find_run_record(job, context)
    det_f = None
    if name == "det_f":
        det_f = read_det_f(context.storage.result_path(job.id), frame.index)
    before = find_frame(frame.index - 1, job, context) if frame.index else None
    return field(
        name,
        positions=frame.positions,
        previous=before.positions if before else None,
        source=run.source_points,
        target=run.target_points_of(frame.leg),
        det_f=det_f,
    )


def _range(
    values: NDArray[np.float32], low: float | None, high: float | None
) -> tuple[float, float]:
    """The range to encode: the one asked for, else that of the values.

    Raises:
        ProblemError: 422, it ends before it begins.
    """
    finite = values[np.isfinite(values)]
    least, most = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    lower = least if low is None else low
    upper = max(most, lower) if high is None else high
    if upper < lower:
        if low is None:
            return upper, upper
        raise ProblemError(422, f"high is {upper:g} and low {lower:g}.", "Give a low below high.")
    return lower, upper
