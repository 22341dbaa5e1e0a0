"""What every run does first, done before there is one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from typing import Any

from morph_engine import backend
from morph_engine.code_digest import code_digest
from morph_engine.config import MorphConfig
from morph_engine.errors import MorphError
from morph_engine.methods import DEFAULT_METHOD
from morph_engine.methods.flow import MARGIN, FlowOptions, grid_size
from morph_engine.morphing import morph
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord

LIBRARIES = (
    "h5py", "igl", "scipy.interpolate", "scipy.ndimage", "scipy.sparse.csgraph",
    "scipy.spatial.transform", "threadpoolctl", "trimesh.creation",
)  # fmt: skip
"""Libraries that the engine imports when it first needs them."""

SPHERE_RADIUS = 7.0
"""Of the ball around the particles of the small run [dx], or a little more."""

TYPICAL_EXTENT = 32
"""Half the cells along an axis of the grids of most pairs of shapes by default."""

SMALL: dict[str, Any] = {"sampling.points_per_cell_edge": 1, "frames": 2}
"""A run of 1400 particles of a sphere calls the kernels of a large one, in its second frame the
last of them."""


def warm_up(threads: int, method: str | None = None, extent: int | None = None) -> Iterator[None]:
    """Import what runs need, start Taichi on the best device and load the kernels of a method.

    Only time is saved: what a run computes afterwards is the same to the last bit.

    Args:
        threads: CPU threads of the runs to come.
        method: Their method, as far as one may guess; the default one if not given.
        extent: Half the cells of their grid along an axis, as far as one may guess, where the
            method is the default one: its kernels are compiled for each.

    Yields:
        After each step, so that a run that cannot wait may begin.
    """
    yield
    for name in LIBRARIES:
        import_module(name)
        yield
    backend.start("auto", threads=threads)
    yield
    with suppress(MorphError):  # the job itself tells if its method cannot run
        for _ in morph("sphere", "sphere", small_run(method, extent), threads=threads):
            yield
    code_digest(method or DEFAULT_METHOD)
    yield


def extent_of(record: RunRecord) -> int | None:
    """Half the cells along an axis of the grid of a run, if it is of the default method."""
    options = record.config.method
    if not isinstance(options, FlowOptions):
        return None
    return grid_size(options, record.config, radius=record.radius, ratio=record.ratio)[1]


def small_run(method: str | None = None, extent: int | None = None) -> MorphConfig:
    """A run from the built-in sphere to itself; by default its grid has such an extent [cells]."""
    if method not in (None, DEFAULT_METHOD):
        return configure(overrides=SMALL | {"method": method})
    cell = SPHERE_RADIUS / ((extent or TYPICAL_EXTENT) - MARGIN)
    return configure(overrides=SMALL | {"like_parts": "on", "cell": cell})
