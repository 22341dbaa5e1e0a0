"""What the API has computed on request: each a task in a child process; all of them block.

The settings limit memory and CPU time; `on_start` is called with the child, `on_progress` with the
share that is done.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chamfer_morph.schemas import Fit
from chamfer_morph.worker.sandbox import runner
from chamfer_morph.worker.sandbox.derived_files import ExportOptions
from chamfer_morph.worker.sandbox.runner import (
    MAX_THREADS,
    Answer,
    CrashedError,
    Limits,
    OnProgress,
    OnStart,
    Wording,
)
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from morph_engine.errors import MeshError, MorphError, ResourceError

TASKS = "chamfer_morph.worker.tasks"

SURFACE = Wording("The surface", "compute", "Run the job with fewer points per cell edge.")
RESULT = Wording("The result", "write", "Fetch single frames.")
EXPORT = Wording(
    "The export",
    "compute",
    "Ask for fewer frames at a time, or run the job with fewer points per cell edge.",
)
DECIMATE = "Decimate the mesh; the simulation sees no detail below half a grid unit."


@dataclass(frozen=True, eq=False)
class SampledShape:
    """What a job would begin with.

    Attributes:
        positions: Particle positions [grid units], shape [n, 3], float32.
        warnings: What a user should know of the shape, one sentence each.
    """

    positions: NDArray[np.float32]
    warnings: tuple[str, ...]


def inspect_mesh(
    path: Path, name: str, settings: Settings, on_start: OnStart | None = None
) -> dict[str, Any]:
    """The ingest report of a mesh file that can be used, as it is or scaled to the domain.

    The suffix of the path tells the format; the name is what the user calls the file.

    Returns:
        `IngestReport` as JSON.

    Raises:
        MeshError: The file is no mesh, cannot be filled with particles, or breaks the reader.
        ResourceError: It takes too much memory or time to read.
    """
    arguments = {"path": path, "name": name}
    report: dict[str, Any] = _read_mesh("inspect_mesh", arguments, settings, on_start).value
    return report


def sample_shape(
    shape: Path | str,
    name: str,
    points_per_cell_edge: int,
    fit: Fit,
    settings: Settings,
    on_start: OnStart | None = None,
) -> SampledShape:
    """Fill a shape with particles as a job would whose seed and lattice are the usual ones.

    Args:
        shape: Path of a mesh file, or the name of a built-in shape. A name is never taken for a
            path.
        name: What the user calls it.
        points_per_cell_edge: Lattice points per grid unit and axis.
        fit: As in the configuration; `auto` scales only what does not fit the domain.
        settings: Memory and CPU time that it may take.
        on_start: Called with the child.

    Raises:
        MeshError: It cannot be filled, or there is no such shape.
        ResourceError: It takes too much memory or time.
    """
    if "\0" in f"{shape}{name}":
        raise MeshError("There is no shape with a NUL in its name.", "GET /v1/shapes lists them.")
    arguments = {
        "path": shape if isinstance(shape, Path) else None,
        "name": name,
        "points_per_cell_edge": points_per_cell_edge,
        "fit": fit,
    }
    answer = _read_mesh("sample_shape", arguments, settings, on_start)
    positions = np.frombuffer(answer.binary, "<f4").reshape(-1, 3)
    return SampledShape(positions, tuple(answer.value))


def reconstruct_surface(
    storage: Storage, job_id: str, index: int, settings: Settings, on_start: OnStart | None = None
) -> None:
    """Compute the surface of a frame that is there, counted from 0, and keep it.

    Raises:
        MorphError: The particles enclose nothing, or it takes too much memory or time.
    """
    storage.make_derived_dirs(job_id)
    arguments = {
        "result": storage.result_path(job_id),
        "index": index,
        "path": storage.surface_path(job_id, index),
    }
    limits = _limits(settings, threads=MAX_THREADS)
    runner.run(f"{TASKS}.reconstruct_surface", arguments, limits, SURFACE, on_start=on_start)


def write_partial_result(
    storage: Storage, job_id: str, settings: Settings, on_start: OnStart | None = None
) -> None:
    """See to it that the result of a job that rests has all its frames.

    Raises:
        MorphError: It cannot be written, or takes too much memory or time.
    """
    arguments = {"job_dir": storage.job_dir(job_id)}
    task = f"{TASKS}.write_partial_result"
    runner.run(task, arguments, _limits(settings), RESULT, on_start=on_start)


def make_export(
    storage: Storage,
    job_id: str,
    options: ExportOptions,
    settings: Settings,
    *,
    file_bytes: int,
    on_start: OnStart | None = None,
    on_progress: OnProgress | None = None,
) -> None:
    """Make an export and keep it.

    It may fill the disk by `file_bytes`.

    Raises:
        MorphError: It could not be made.
    """
    storage.make_derived_dirs(job_id)
    result, folder = storage.result_path(job_id), storage.exports_dir(job_id)
    try:
        runner.run(
            f"{TASKS}.make_export",
            {"result": result, "folder": folder, "options": options},
            _limits(settings, file_bytes=file_bytes, threads=MAX_THREADS),
            EXPORT,
            on_start=on_start,
            on_progress=on_progress,
        )
    except MorphError as error:  # shown to users, who need not know where files lie
        for path in map(str, (folder, result)):
            error.cause = error.cause.replace(f"{path}/", "").replace(path, "the result")
        raise


def _limits(settings: Settings, file_bytes: int | None = None, threads: int = 1) -> Limits:
    memory, seconds = settings.export_memory_bytes, settings.export_cpu_seconds
    return Limits(memory, seconds, memory if file_bytes is None else file_bytes, threads)


def _read_mesh(
    task: str, arguments: dict[str, Any], settings: Settings, on_start: OnStart | None
) -> Answer:
    """What a task answers that reads a mesh; errors call its file what the user calls it."""
    limits = Limits(settings.inspect_memory_bytes, settings.inspect_cpu_seconds)
    name, path = arguments["name"], arguments["path"]
    try:
        return runner.run(
            f"{TASKS}.{task}", arguments, limits, Wording(name, "read", DECIMATE), on_start=on_start
        )
    except CrashedError as error:
        raise MeshError(
            f"{name} breaks the program that reads meshes ({error.reason}).",
            "Export the mesh again, as OBJ, STL or GLB.",
        ) from None
    except ResourceError:
        raise
    except MorphError as error:
        cause = error.cause
        if path is not None:
            cause = cause.replace(str(path), name).replace(path.name, name)
        raise MeshError(cause, error.remedy) from None
