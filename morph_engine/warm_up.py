"""What every run does first, done before there is one."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any

from morph_engine import backend
from morph_engine.code_digest import code_digest
from morph_engine.methods import DEFAULT_METHOD
from morph_engine.methods.flow import FlowOptions, cell_edge
from morph_engine.morphing import morph
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord

LIBRARIES = (
    "h5py", "igl", "ot.gromov", "scipy.interpolate", "scipy.ndimage", "scipy.sparse.csgraph",
    "scipy.spatial.transform", "threadpoolctl", "trimesh.creation",
)  # fmt: skip
"""Libraries that the engine imports when it first needs them."""

SMALL: dict[str, Any] = {"sampling.points_per_cell_edge": 1, "frames": 1, "like_parts": "off"}
"""A run of 1400 particles calls the kernels of a large one."""


def warm_up(threads: int, cell: float | None = None) -> Iterator[None]:
    """Import what runs need, start Taichi on the best device and load the default method's kernels.

    Only time is saved: what a run computes afterwards is the same to the last bit.

    Args:
        threads: CPU threads of the runs to come.
        cell: Edge of their grid cells [dx], which kernels are compiled for, if one may guess.

    Yields:
        After each step, so that a run that cannot wait may begin.
    """
    yield
    for name in LIBRARIES:
        import_module(name)
        yield
    backend.start("auto", threads=threads)
    yield
    # particles are 1 dx apart and as many as target points, so that cells have the edge as given
    config = configure(overrides=SMALL | ({"cell": cell} if cell else {}))
    for _ in morph("sphere", "sphere", config, threads=threads):
        yield
    code_digest(DEFAULT_METHOD)
    yield


def cell_of(record: RunRecord) -> float | None:
    """Edge of the grid cells of a run [dx], if it is of the default method."""
    config, options = record.config, record.config.method
    if not isinstance(options, FlowOptions):
        return None
    counts = len(record.source_points), len(record.target_points)
    return cell_edge(options, config.spacing, *counts)
