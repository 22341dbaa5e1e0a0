"""/v1/jobs/{id}/...: the result file, single frames, metrics, configuration and log."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import anyio
from fastapi import APIRouter, Query, Request, Response
from starlette.responses import FileResponse

from chamfer_morph.schemas import FrameFormat
from chamfer_morph.server.auth import AuthenticatedRoute, Reader
from chamfer_morph.server.context import Context
from chamfer_morph.server.http import array_encoding
from chamfer_morph.server.http.conditional import binary_responses, file_response
from chamfer_morph.server.http.csv_table import csv_table
from chamfer_morph.server.http.remote_file import remote_file_response
from chamfer_morph.server.routes.job_lookup import (
    FinishedFrame,
    VisibleJob,
    find_result,
    refuse_lost,
)
from chamfer_morph.server.routes.job_view import file_stem
from chamfer_morph.worker.event_log import EventLog
from morph_engine.files import file_sha256

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}", tags=["results"], route_class=AuthenticatedRoute
)

HDF5 = "application/vnd.hdfgroup.hdf5"

TABLES_KEPT = 64
"""Tables of metrics kept in memory, some 50 kB each."""


@router.get(
    "/result",
    operation_id="getResult",
    summary="Download the result",
    response_class=Response,
    responses=binary_responses("The file.", [HDF5], ranges=True),
)
async def get_result(job: VisibleJob, request: Request, context: Context) -> Response:
    """The VTKHDF file, for ParaView, VTK and h5py; its ETag is its SHA-256.

    Supports Range, If-Range and If-None-Match. For a cancelled, failed or timed out job it holds
    the frames that were finished.
    """
    filename = f"{file_stem(job)}.vtkhdf"
    if job.outcome is not None:
        remote = await anyio.to_thread.run_sync(context.storage.remote_result, job.id)
        if remote is not None and remote.size == job.outcome.size_bytes:
            digest = job.outcome.sha256
            return await remote_file_response(
                request, remote, digest, media_type=HDF5, filename=filename
            )
    path = await find_result(job, request, context)
    stat = path.stat()
    digest = await anyio.to_thread.run_sync(_digest, path, stat.st_mtime_ns, stat.st_size)
    if job.outcome is not None and digest != job.outcome.sha256:
        cause = f"{path} does not have the SHA-256 that the job has reported."
        await anyio.to_thread.run_sync(refuse_lost, job, cause, context)
    return file_response(request, path, digest, media_type=HDF5, filename=filename)


@router.get(
    "/frames/{index}",
    operation_id="getFrame",
    summary="Fetch one frame",
    response_class=Response,
    responses=array_encoding.array_responses(
        "Positions of all particles.", {"Morph-Frame": ("integer", "Index of the frame.")}
    ),
)
def get_frame(
    job: VisibleJob,
    frame: FinishedFrame,
    request: Request,
    format: Annotated[FrameFormat, Query(description="How to encode the positions.")] = "f32",
) -> Response:
    """Particle positions of a finished frame, also while the job runs. Frames count from 0; -1 is
    the last one.

    `f32`: little-endian float32, x y z of one particle after the other [grid units]. `u16`:
    little-endian uint16 likewise; position = Morph-Offset + Morph-Scale x value. `ply`: a binary
    PLY point cloud. `npy`: a NumPy array of shape [n, 3].
    """  # noqa: D205
    extent = job.spec.config.grid.half_extent
    headers = {"Morph-Frame": str(frame.index)}
    return array_encoding.array_response(request, frame.positions, format, extent, headers)


@router.get(
    "/metrics",
    operation_id="getMetrics",
    summary="Metrics of every frame",
    response_model=list[dict[str, float]],
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
def get_metrics(
    job: VisibleJob,
    context: Context,
    format: Annotated[Literal["json", "csv"], Query(description="Format of the table.")] = "json",
) -> Any:
    """One row for each finished frame, also while the job runs; docs/metrics.md has the units."""
    log = context.storage.events(job.id)
    media_type = "application/json" if format == "json" else "text/csv; charset=utf-8"
    return Response(_metrics(log, log.version(), format), media_type=media_type)


@router.get("/config", operation_id="getConfig", summary="The resolved configuration")
def get_config(job: VisibleJob) -> dict[str, Any]:
    """Every setting that the job runs with."""
    return job.spec.config.model_dump(mode="json")


@router.get(
    "/log",
    operation_id="getLog",
    summary="The log of the engine",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def get_log(caller: Reader, job: VisibleJob, context: Context) -> Response:
    """Warnings and errors of the processes that computed the job, as text; not for share links."""
    path = context.storage.job_dir(job.id) / "log.txt"
    if not path.is_file():
        return Response("", media_type="text/plain; charset=utf-8")
    return FileResponse(path, media_type="text/plain; charset=utf-8")


@lru_cache(maxsize=TABLES_KEPT)
def _metrics(log: EventLog, version: tuple[int, int], format: Literal["json", "csv"]) -> bytes:
    """The table at the end of one version of a log; a frame computed again counts once."""
    rows: dict[int, dict[str, float]] = {}
    for event in log.read(limit=1 << 30):
        if event.type == "frame":
            with suppress(LookupError, TypeError, ValueError):  # a damaged line
                index = int(event.data["frame"])
                rows[index] = {
                    "frame": index,
                    **event.data["metrics"],
                    "seconds": event.data["seconds"],
                }
    table = [rows[index] for index in sorted(rows)]
    if format == "json":
        return json.dumps(table, separators=(",", ":")).encode()
    names = list(dict.fromkeys(name for row in table for name in row)) or ["frame"]
    return csv_table(names, ([row.get(name, "") for name in names] for row in table)).encode()


@lru_cache(maxsize=1000)
def _digest(path: Path, changed_at: int, size: int) -> str:
    """SHA-256 of a file as it was last changed."""
    return file_sha256(path)
