"""What the API has computed on request, each by a task in a child process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chamfer_morph.schemas import Fit
from chamfer_morph.worker.frame_reader import Colors
from chamfer_morph.worker.sandbox import runner
from chamfer_morph.worker.sandbox.budget import Budget
from chamfer_morph.worker.sandbox.derived_files import ExportOptions
from chamfer_morph.worker.sandbox.runner import (
    MAX_THREADS,
    Answer,
    Computation,
    CrashedError,
    Limits,
    Wording,
)
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from morph_engine.errors import MeshError, MorphError, ResourceError
from morph_engine.geometry.solid import Solid
from morph_engine.geometry.upward import Up
from morph_engine.results.run_record import Role
from morph_engine.sections import PlacementConfig

TASKS = "chamfer_morph.worker.tasks"

SURFACE = Wording("The surface", "compute", "Run the job with fewer points per cell edge.")
COLORS = Wording("The colours", "look up", "Wait until the job has ended.")
RESULT = Wording("The result", "write", "Fetch individual frames.")
EXPORT = Wording(
    "The export",
    "compute",
    "Request fewer frames at a time, or run the job with fewer points per cell edge.",
)
DECIMATE = "Decimate the mesh; the simulation resolves no detail below half a grid unit."


@dataclass(frozen=True, eq=False)
class SampledShape:
    """What a job would begin with.

    Attributes:
        positions: Particle positions [grid units], shape [n, 3], float32.
        message: What the fit does to both shapes, a sentence; empty where they stay.
        turning: Which of them are turned to stand upright, a sentence; empty for none.
        up: The axis of the domain that points upwards.
        to_user: Grid units to the shape's own coordinates, shape [4, 4]; acts on columns.
    """

    positions: NDArray[np.float32]
    message: str
    turning: str
    up: Up
    to_user: list[list[float]]


class OtherEnd(NamedTuple):
    """The other shape of a morph, which the fit looks at.

    Attributes:
        role: Which end it is.
        solid: Its size and place.
    """

    role: Role
    solid: Solid


class Sandbox:
    """Children with the memory and CPU time that the settings allow. Calls block.

    Attributes:
        reading_bytes: Memory of a child that reads a mesh [bytes].
        writing_bytes: Memory of a child that writes a file of frames [bytes].
    """

    def __init__(self, settings: Settings, storage: Storage, budget: Budget) -> None:
        self._settings = settings
        self._storage = storage
        self.reading_bytes: int = min(settings.inspect_memory_bytes, budget.largest_bytes)
        self.writing_bytes: int = min(settings.export_memory_bytes, budget.largest_bytes)

    def inspect_mesh(self, path: Path, name: str, computation: Computation) -> dict[str, Any]:
        """The ingest report of a mesh file that can be used, as it is or scaled to the domain.

        The suffix of the path tells the format; the name is what the user calls the file.

        Returns:
            `IngestReport` as JSON.

        Raises:
            MeshError: The file is no mesh, cannot be filled with particles, or breaks the reader.
            ResourceError: It takes too much memory or time to read.
        """
        arguments = {"path": path, "name": name}
        report: dict[str, Any] = self._read_mesh("inspect_mesh", arguments, computation).value
        return report

    def sample_shape(
        self,
        shape: Path | str,
        name: str,
        points_per_cell_edge: int,
        fit: Fit,
        other: OtherEnd | None,
        poses: PlacementConfig,
        computation: Computation,
    ) -> SampledShape:
        """Fill a shape with particles as a job would whose seed and lattice are the usual ones.

        Args:
            shape: Path of a mesh file, or the name of a built-in shape. A name is never taken for
                a path.
            name: What the user calls it.
            points_per_cell_edge: Lattice points per grid unit and axis.
            fit: As in the configuration.
            other: The other end of the morph; None for a shape like it.
            poses: How both ends are turned, scaled and moved.
            computation: Told of the child.

        Raises:
            MeshError: It cannot be filled, or there is no such shape.
            ResourceError: It takes too much memory or time.
        """
        if "\0" in f"{shape}{name}":
            raise MeshError(
                "There is no shape with a NUL in its name.", "GET /v1/shapes lists them."
            )
        arguments = {
            "path": shape if isinstance(shape, Path) else None,
            "name": name,
            "points_per_cell_edge": points_per_cell_edge,
            "fit": fit,
            "other_role": other.role if other else None,
            "other_volume": other.solid.volume if other else 0.0,
            "other_bounds": other.solid.bounds.tolist() if other else None,
            "other_up": other.solid.up if other else None,
            "other_built_in": other is not None and other.solid.built_in,
            "poses": poses.model_dump(mode="json"),
        }
        answer = self._read_mesh("sample_shape", arguments, computation)
        positions = np.frombuffer(answer.binary, "<f4").reshape(-1, 3)
        return SampledShape(positions, **answer.value)

    def reconstruct_surface(self, job_id: str, index: int, computation: Computation) -> None:
        """Compute the surface of a frame that is there, counted from 0, and keep it.

        Raises:
            MorphError: The particles enclose nothing, or it takes too much memory or time.
        """
        self._storage.make_derived_dirs(job_id)
        result, path = self._storage.result_path(job_id), self._storage.surface_path(job_id, index)
        arguments = {"result": result, "index": index, "path": path}
        limits = self._limits(threads=MAX_THREADS, reads=result.parent, writes=path.parent)
        runner.run(f"{TASKS}.reconstruct_surface", arguments, limits, SURFACE, computation)

    def look_up_colors(self, job_id: str, computation: Computation) -> Colors | None:
        """Colours of the particles of a job that runs; None where no shape has any.

        Raises:
            MorphError: A frame is damaged, or it takes too much memory or time.
        """
        result = self._storage.result_path(job_id)
        limits = self._limits(reads=result.parent)
        task = f"{TASKS}.look_up_colors"
        answer = runner.run(task, {"result": result}, limits, COLORS, computation)
        reached = answer.value
        if not reached:
            return None
        rgb = np.frombuffer(answer.binary, np.uint8).reshape(len(reached), -1, 3)
        return Colors(rgb, reached)

    def write_partial_result(self, job_id: str, computation: Computation) -> None:
        """See to it that the result of a job that rests has all its frames.

        Raises:
            MorphError: It cannot be written, or takes too much memory or time.
        """
        folder = self._storage.job_dir(job_id)
        task = f"{TASKS}.write_partial_result"
        limits = self._limits(writes=folder)
        runner.run(task, {"job_dir": folder}, limits, RESULT, computation)

    def make_export(
        self, job_id: str, options: ExportOptions, file_bytes: int, computation: Computation
    ) -> None:
        """Make an export of at most `file_bytes`, and keep it.

        Raises:
            MorphError: It could not be made.
        """
        self._storage.make_derived_dirs(job_id)
        result, folder = self._storage.result_path(job_id), self._storage.exports_dir(job_id)
        arguments = {"result": result, "folder": folder, "options": options}
        limits = self._limits(file_bytes, MAX_THREADS, reads=result.parent, writes=folder)
        try:
            runner.run(f"{TASKS}.make_export", arguments, limits, EXPORT, computation)
        except MorphError as error:  # shown to users, who need not know where files lie
            for path in map(str, (folder, result)):
                error.cause = error.cause.replace(f"{path}/", "").replace(path, "the result")
            raise

    def _limits(
        self,
        file_bytes: int | None = None,
        threads: int = 1,
        *,
        reads: Path | None = None,
        writes: Path | None = None,
    ) -> Limits:
        return Limits(
            self.writing_bytes,
            self._settings.export_cpu_seconds,
            self.writing_bytes if file_bytes is None else file_bytes,
            threads,
            reads=(reads,) if reads else (),
            writes=(writes,) if writes else (),
        )

    def _read_mesh(self, task: str, arguments: dict[str, Any], computation: Computation) -> Answer:
        """What a task answers that reads a mesh; errors call its file what the user calls it."""
        name, path = arguments["name"], arguments["path"]
        reads = () if path is None else (path,)
        limits = Limits(self.reading_bytes, self._settings.inspect_cpu_seconds, reads=reads)
        wording = Wording(name, "read", DECIMATE)
        try:
            return runner.run(f"{TASKS}.{task}", arguments, limits, wording, computation)
        except CrashedError as error:
            raise MeshError(
                f"{name} crashed the program that reads meshes ({error.reason}).",
                "Export the mesh again, as OBJ, STL or GLB.",
            ) from None
        except ResourceError:
            raise
        except MorphError as error:
            cause = error.cause
            if path is not None:
                cause = cause.replace(str(path), name).replace(path.name, name)
            raise MeshError(cause, error.remedy) from None
