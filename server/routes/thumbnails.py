"""/v1/jobs/{id}/thumbnail: a small picture of the newest frame."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import anyio
from fastapi import APIRouter, Request, Response

from chamfer_morph.server import job_representation
from chamfer_morph.server.auth import Reader
from chamfer_morph.server.context import Service, Services
from chamfer_morph.server.http.array_encoding import BINARY
from chamfer_morph.server.http.conditional import file_answer
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.frame_reader import count_frames
from chamfer_morph.worker.queue import JobRecord
from morph_engine.config import MorphConfig
from morph_engine.errors import ResultError
from morph_engine.files import replacing

router = APIRouter(prefix="/jobs/{job_id}", tags=["results"])

WEBP = "image/webp"


@router.get(
    "/thumbnail",
    operation_id="getThumbnail",
    summary="A small picture",
    response_class=Response,
    responses={
        200: {"content": {WEBP: BINARY}, "description": "240 x 180 pixels of the newest frame."},
        304: {"description": "You have it already."},
    },
)
async def get_thumbnail(
    job_id: str, request: Request, caller: Reader, service: Services
) -> Response:
    """A picture of the newest frame, also while the job runs; its ETag changes with it."""
    record = await anyio.to_thread.run_sync(job_representation.find, job_id, caller, service)
    body = await anyio.to_thread.run_sync(_kept, record, service)
    if body is None:
        body = await anyio.to_thread.run_sync(_draw, record, service, limiter=service.computations)
    return file_answer(request, body, WEBP)


def _kept(record: JobRecord, service: Service) -> bytes | None:
    """The picture of the newest frame, if it has been drawn before.

    Raises:
        ProblemError: 404, there is no frame yet.
    """
    try:
        return _path(record, service).read_bytes()
    except FileNotFoundError:
        return None


def _draw(record: JobRecord, service: Service) -> bytes:
    """Draw it, unless that has been done while this waited for its turn."""
    if (kept := _kept(record, service)) is not None:
        return kept
    from morph_engine.rendering.pictures import thumbnail

    path = _path(record, service)
    frame = job_representation.find_frame(record, -1, service)
    spacing = MorphConfig.model_validate(record.spec.config).spacing
    picture: bytes = thumbnail(frame.positions, spacing)
    with suppress(OSError, ResultError):  # the disk is full, or the job has been deleted
        service.storage.make_derived_dirs(record.id)
        with replacing(path) as temporary:
            temporary.write_bytes(picture)
        for older in path.parent.glob("thumbnail-*.webp"):
            if older != path:
                older.unlink(missing_ok=True)
    return picture


def _path(record: JobRecord, service: Service) -> Path:
    """Where the picture of the newest frame lies, named by the number of frames there are."""
    result = service.storage.result_path(record.id)
    count = count_frames(result, record.state.finished)
    if not count:
        raise ProblemError(404, "There is no frame yet.", "Wait until the job has finished one.")
    return service.storage.derived_dir(record.id) / f"thumbnail-{count:06d}.webp"
