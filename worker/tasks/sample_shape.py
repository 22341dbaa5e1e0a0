"""The particles of a shape before any job is submitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import morph_engine.geometry.text  # noqa: F401 - its memory is the program's, not the task's
from chamfer_morph.schemas import Fit
from chamfer_morph.worker.sandbox.runner import Answer
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.placement import place, placed
from morph_engine.geometry.sampling import sample_lattice
from morph_engine.geometry.shapes import make
from morph_engine.geometry.solid import Solid
from morph_engine.geometry.upward import Up
from morph_engine.ingest import check_mesh
from morph_engine.results.run_record import Role
from morph_engine.sections import PlacementConfig


def run(
    path: Path | None,
    name: str,
    points_per_cell_edge: int,
    fit: Fit,
    other_role: Role | None,
    other_volume: float,
    other_bounds: list[list[float]] | None,
    other_up: Up | None,
    other_built_in: bool,
    poses: dict[str, Any],
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
        other_up: The axis that points upwards in it.
        other_built_in: Whether it is a built-in shape.
        poses: How both are turned, scaled and moved, as `placement` of the configuration.

    Returns:
        Where it is put, as `placed` of `SampledShape` takes it, and behind it the positions
        [grid units], shape [n, 3], little-endian float32.

    Raises:
        MeshError: It cannot be filled, or there is no such shape.
    """
    mesh = make(name) if path is None else replace(load_mesh(path), name=name)
    own = Solid.of(mesh)
    other = own
    if other_bounds is not None:
        bounds = np.array(other_bounds, np.float64)
        other = Solid(other_volume, bounds, other_built_in, other_up)
    source, target = (other, own) if other_role == "source" else (own, other)
    placement = place(source, target, fit=fit, poses=PlacementConfig.model_validate(poses))
    to_grid = placement.target if other_role == "source" else placement.source
    in_domain = placed(mesh, to_grid)
    check_mesh(in_domain, own=mesh)
    positions = sample_lattice(in_domain, spacing=1 / points_per_cell_edge)
    told = {
        "message": placement.message,
        "turning": placement.turning,
        "up": placement.up,
        "to_user": to_grid.inverse().matrix.tolist(),
    }
    return Answer(told, positions.astype("<f4").tobytes())
