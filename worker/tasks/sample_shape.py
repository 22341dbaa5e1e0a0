"""The particles of a shape before any job is submitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from chamfer_morph.schemas import Fit
from chamfer_morph.worker.sandbox.runner import Answer
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.sampling import HALF_EXTENT, fit_to_domain, sample_lattice
from morph_engine.geometry.shapes import make
from morph_engine.ingest import check_mesh


def run(path: Path | None, name: str, points_per_cell_edge: int, fit: Fit) -> Answer:
    """Fill a shape with particles.

    Args:
        path: A mesh file; None for the built-in shape of the name.
        name: What the user calls it.
        points_per_cell_edge: Lattice points per grid unit and axis.
        fit: As in the configuration; `auto` scales only what does not fit the domain.

    Returns:
        Warnings, and behind them the positions [grid units], shape [n, 3], little-endian float32.

    Raises:
        MeshError: It cannot be filled, or there is no such shape.
    """
    mesh = make(name) if path is None else replace(load_mesh(path), name=name)
    warnings = []
    if fit == "auto":
        fits = bool(np.abs(mesh.bounds).max() <= HALF_EXTENT)
        fit = "none" if fits else "volume"
        if not fits:
            warnings.append("It does not fit the domain as it is, and is shown scaled to fit.")
    mesh, _ = fit_to_domain(mesh, mode=fit)
    check_mesh(mesh)
    positions = sample_lattice(mesh, spacing=1 / points_per_cell_edge)
    return Answer(warnings, positions.astype("<f4").tobytes())
