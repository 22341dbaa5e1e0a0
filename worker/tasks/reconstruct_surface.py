"""The surface of a frame, computed in a child with little memory and kept beside the job.

The child is this module, run with RESULT INDEX FINISHED FILE; it prints what went wrong.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chamfer_morph.worker import sandbox
from chamfer_morph.worker.frame_reader import mesh_in_grid_units, read_frame, read_record
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from chamfer_morph.worker.tasks.file_task import Making, make_file, saying_why
from morph_engine.errors import ResultError
from morph_engine.files import replacing, wait_for
from morph_engine.results.run_record import RunRecord

SURFACE = Making("The surface", "compute", "Run the job with fewer points per cell edge.")


@dataclass(frozen=True, eq=False)
class KeptSurface:
    """A surface as it lies on the disk.

    Attributes:
        vertices: Corner positions [grid units], shape [V, 3], float64.
        faces: Vertex indices, shape [F, 3], int32.
        report: `watertight`, `bodies`, `largest` (share of the largest in the area), `volume`
            [dx^3], and, where the target is a mesh, `deviation` [dx] as of `surface_deviation`.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    report: dict[str, Any]

    @classmethod
    def load(cls, path: Path) -> KeptSurface:
        """Read one that is there."""
        with np.load(path, allow_pickle=False) as arrays:
            report = json.loads(arrays["report"].tobytes())
            return cls(arrays["vertices"], arrays["faces"], report)

    def save(self, path: Path) -> None:
        """Write it as a whole."""
        report = np.frombuffer(json.dumps(self.report).encode(), np.uint8)
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, vertices=self.vertices, faces=self.faces, report=report)


def compute_surface(
    storage: Storage,
    job_id: str,
    index: int,
    finished: bool,
    settings: Settings,
    meet: Callable[[subprocess.Popen[bytes]], None],
) -> None:
    """Compute the surface of a frame that is there, and keep it; blocks.

    Args:
        storage: Where the frame is, and the surface will be.
        job_id: The job.
        index: Index of the frame, from 0.
        finished: Whether the job is.
        settings: Memory and CPU time that it may take.
        meet: Called with the child.

    Raises:
        MorphError: The particles enclose nothing, or it takes too much memory or time.
    """
    result, path = storage.result_path(job_id), storage.surface_path(job_id, index)
    storage.make_derived_dirs(job_id)
    arguments = [str(result), str(index), str(int(finished)), str(path)]
    make_file(
        __name__,
        arguments,
        SURFACE,
        settings,
        threads=sandbox.MOST_THREADS,
        meet=meet,
    )


def _main() -> None:
    from morph_engine.geometry import surface_reconstruction  # noqa: F401  the program's own memory is free

    sandbox.enter()
    result, index, finished, path = sys.argv[1:]
    with saying_why(SURFACE):
        _keep(Path(result), int(index), finished == "1", Path(path))


def _keep(result: Path, index: int, finished: bool, path: Path) -> None:
    with wait_for(path.parent / "lock"):  # another API may be at it
        if path.exists():
            return
        frame, record = read_frame(result, index, finished), read_record(result)
        if frame is None or record is None:
            raise ResultError("The frame has gone meanwhile.", "Ask for it again.")
        _reconstruct(frame.positions, record).save(path)


def _reconstruct(positions: NDArray[np.float32], record: RunRecord) -> KeptSurface:
    from morph_engine.config import MorphConfig
    from morph_engine.geometry.surface_reconstruction import (
        reconstruct_surface,
        surface_deviation,
    )

    found = reconstruct_surface(positions, MorphConfig.model_validate(record.config).spacing)
    report: dict[str, Any] = {
        "watertight": found.watertight,
        "bodies": found.bodies,
        "largest": found.area_share_of_largest,
        "volume": found.volume,
    }
    target = mesh_in_grid_units(record, "target")
    if target is not None:
        report["deviation"] = surface_deviation(found, target)
    return KeptSurface(found.vertices, found.faces, report)


if __name__ == "__main__":
    _main()
