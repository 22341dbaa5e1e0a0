"""The particles of a shape before any job is submitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from chamfer_morph.schemas import Fit
from chamfer_morph.worker.sandbox.runner import Answer
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.placement import Solid, place, placed
from morph_engine.geometry.sampling import sample_lattice
from morph_engine.geometry.shapes import make
from morph_engine.ingest import check_mesh
from morph_engine.results.run_record import Role


def run(
    path: Path | None,
    name: str,
    points_per_cell_edge: int,
    fit: Fit,
    other_role: Role | None,
    other_volume: float,
    other_bounds: list[list[float]] | None,
) -> Answer:
    """Fill a shape with particles.

    Args:
        path: A mesh file; None for the built-in shape of the name.
        name: What the user calls it.
        points_per_cell_edge: Lattice points per grid unit and axis.
        fit: As in the configuration.
        other_role: Which end of the morph the other shape is; None for a shape like this one.
        other_volume: Its volume.
        other_bounds: Lower and upper corner of its bounding box.

    Returns:
        What the fit does to both shapes, a sentence, and behind it the positions [grid units],
        shape [n, 3], little-endian float32.

    Raises:
        MeshError: It cannot be filled, or there is no such shape.
    """
    mesh = make(name) if path is None else replace(load_mesh(path), name=name)
    own = Solid.of(mesh)
    other = own
    if other_bounds is not None:
        other = Solid(other_volume, np.array(other_bounds, np.float64))
    source, target = (other, own) if other_role == "source" else (own, other)
    placement = place(source, target, fit=fit)
    mesh = placed(mesh, placement.target if other_role == "source" else placement.source)
    check_mesh(mesh)
    positions = sample_lattice(mesh, spacing=1 / points_per_cell_edge)
    return Answer(placement.message, positions.astype("<f4").tobytes())
