"""The particles of a shape before any job is submitted, sampled in a child with little memory.

The child is this module, run with KIND SHAPE NAME POINTS_PER_CELL_EDGE FIT, where the kind is
`file` or `shape`; it prints a line of JSON and behind it the positions.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from chamfer_morph.schemas import Fit
from chamfer_morph.worker import sandbox
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.tasks.inspect_mesh import read_mesh, refusal
from morph_engine.errors import MeshError, MorphError


@dataclass(frozen=True, eq=False)
class Preview:
    """What a job would begin with.

    Attributes:
        positions: Particle positions [grid units], shape [n, 3], float32.
        warnings: What a user should know of the shape, one sentence each.
    """

    positions: NDArray[np.float32]
    warnings: tuple[str, ...]


def sample_shape(
    shape: Path | str, name: str, points_per_cell_edge: int, fit: Fit, settings: Settings
) -> Preview:
    """Fill a shape with particles as a job would whose seed and lattice are the usual ones.

    Args:
        shape: Path of a mesh file, or the name of a built-in shape. A name is never taken for a
            path.
        name: What the user calls it.
        points_per_cell_edge: Lattice points per grid unit and axis.
        fit: As in the configuration; `auto` scales only what does not fit the domain.
        settings: Memory and CPU time that it may take.

    Raises:
        MeshError: It cannot be filled, or there is no such shape.
        ResourceError: It takes too much memory or time.
    """
    if "\0" in f"{shape}{name}":
        raise MeshError("There is no shape with a NUL in its name.", "GET /v1/shapes lists them.")
    kind = "file" if isinstance(shape, Path) else "shape"
    arguments = [kind, str(shape), name, str(points_per_cell_edge), fit]
    head, _, body = read_mesh(__name__, arguments, name, settings).partition(b"\n")
    answer = json.loads(head)
    if "error" in answer:
        raise MeshError(answer["error"]["cause"], answer["error"]["remedy"])
    positions = np.frombuffer(body, "<f4").reshape(-1, 3)
    return Preview(positions, tuple(answer["warnings"]))


def _main() -> None:
    from morph_engine.geometry import ingest, shapes  # noqa: F401  the program's own memory is free

    sandbox.enter()
    kind, shape, name, points_per_cell_edge, fit = sys.argv[1:]
    try:
        preview = _sample(kind, shape, name, int(points_per_cell_edge), fit)
    except MemoryError:
        sys.exit(ExitCode.OUT_OF_MEMORY)
    except MorphError as error:
        sys.stdout.write(json.dumps(refusal(error, Path(shape), name)))
        return
    sys.stdout.write(json.dumps({"warnings": preview.warnings}) + "\n")
    sys.stdout.flush()
    sys.stdout.buffer.write(preview.positions.astype("<f4").tobytes())


def _sample(kind: str, shape: str, name: str, points_per_cell_edge: int, fit: str) -> Preview:
    from morph_engine.geometry.ingest import check_mesh
    from morph_engine.geometry.mesh import load_mesh
    from morph_engine.geometry.sampling import HALF_EXTENT, fit_to_domain, sample_lattice
    from morph_engine.geometry.shapes import make

    mesh = replace(load_mesh(shape), name=name) if kind == "file" else make(shape)
    warnings: tuple[str, ...] = ()
    if fit == "auto":
        fits = bool(np.abs(mesh.bounds).max() <= HALF_EXTENT)
        fit = "none" if fits else "volume"
        if not fits:
            warnings = ("It does not fit the domain as it is, and is shown scaled to fit.",)
    mesh, _ = fit_to_domain(mesh, mode=fit)  # type: ignore[arg-type]
    check_mesh(mesh)
    return Preview(sample_lattice(mesh, spacing=1 / points_per_cell_edge), warnings)


if __name__ == "__main__":
    _main()
