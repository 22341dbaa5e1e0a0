"""/v1/jobs/{id}/thumbnail: a small picture of the newest frame."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import anyio
from fastapi import APIRouter, Request, Response

from chamfer_morph.server.auth import AuthenticatedRoute
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.conditional import binary_responses, bytes_response
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.particle_colors import find_colors
from chamfer_morph.server.routes.job_lookup import VisibleJob, fetch, find_frame
from chamfer_morph.worker.frame_reader import Colors, count_frames, read_run_record
from chamfer_morph.worker.job_record import JobRecord
from morph_engine.errors import ResultError
from morph_engine.files import replacing

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}", tags=["results"], route_class=AuthenticatedRoute
)

WEBP = "image/webp"


@router.get(
    "/thumbnail",
    operation_id="getThumbnail",
    summary="A thumbnail",
    response_class=Response,
    responses=binary_responses("240 x 180 pixels of the newest frame.", [WEBP]),
)
async def get_thumbnail(job: VisibleJob, request: Request, context: Context) -> Response:
    """A picture of the newest frame, also while the job runs; its ETag changes with it."""
    path = await anyio.to_thread.run_sync(_path, job, context)
    try:
        body = await anyio.Path(path).read_bytes()
    except FileNotFoundError:
        run = await context.compute(read_run_record, context.storage.result_path(job.id))
        colors = await find_colors(job, run, request, context) if run else None
        body = await context.thumbnails.get(
            (job.id, path.name), lambda _: _draw(path, colors, job, context), request, job.owner
        )
    return bytes_response(request, body, WEBP)


def _draw(path: Path, colors: Colors | None, job: JobRecord, context: ServerContext) -> bytes:
    """Draw the newest frame, and keep the picture."""
    from morph_engine.rendering.pictures import thumbnail

    frame = find_frame(-1, job, context)
    spacing = job.spec.config.spacing
    placement = job.placement
    own = colors.at(frame.index) if colors else None
    up = placement.up if placement else "y"
    picture: bytes = thumbnail(frame.positions, spacing, own, up)
    with suppress(OSError, ResultError):  # the disk is full, or the job has been deleted
        context.storage.make_derived_dirs(job.id)
        with replacing(path) as temporary:
            temporary.write_bytes(picture)
        for older in path.parent.glob("thumbnail-*.webp"):
            if older != path:
                older.unlink(missing_ok=True)
    return picture


def _path(job: JobRecord, context: ServerContext) -> Path:
    """Where the picture of the newest frame lies, named by the number of frames there are.

    Raises:
        ProblemError: 404, there is no frame yet.
    """
    fetch(job, context)
    count = count_frames(context.storage.result_path(job.id))
    if not count:
        raise ProblemError(404, "There is no frame yet.", "Wait until the job has finished one.")
    return context.storage.derived_dir(job.id) / f"thumbnail-{count:06d}.webp"
