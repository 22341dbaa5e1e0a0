"""Distances that a warp carries, blended on the fine lattice."""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.flow.warp import Warp
from morph_engine.mpm.grid import Grid

REFINEMENT = 2
"""Lattice steps of the distances per grid cell."""

COARSENING = 2
"""Grid cells between the points at which a warp is evaluated."""


class Carrier:
    """Distances that are carried by a warp and blended, on the device."""

    def __init__(self, warp: Warp, ends: list[NDArray[np.float32]], grid: Grid) -> None:
        self._warp = warp
        self._grid = grid
        self._ends = [backend.active().upload(end.ravel()) for end in ends]
        self._level = backend.active().scalars(ends[0].size)
        self._count = ends[0].shape[0]
        axis = grid.origin + grid.dx * np.arange(0, grid.resolution + COARSENING, COARSENING)
        self._coarse_count = len(axis)
        self._nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)

    def blended(self, share: float) -> NDArray[np.float32]:
        """phi_s on the fine lattice [dx], shape [m, m, m]."""
        upload = backend.active().upload
        carry(
            *map(upload, self._warp.ends(self._nodes, share)), *self._ends, self._level, share,
            self._grid.origin, self._grid.dx / REFINEMENT, self._count, self._coarse_count,
        )  # fmt: skip
        level: NDArray[np.float32] = (
            self._level.to_numpy().astype(np.float32).reshape((self._count,) * 3)
        )
        return level


@ti.func
def corner_and_weights(along, count: int):
    """Lowest lattice point around a place given in steps, and how far along the cell it is."""
    inside = ti.math.clamp(along, 0.0, count - 1.001)
    corner = ti.floor(inside, int)
    return corner, inside - corner


@ti.func
def interpolated(field: ti.template(), along, count: int):
    """Trilinear interpolation of a field at a place given in lattice steps."""
    corner, f = corner_and_weights(along, count)
    total = ti.zero(field[0])
    for i, j, k in ti.static(ti.ndrange(2, 2, 2)):
        x = f.x if ti.static(i == 1) else 1 - f.x
        y = f.y if ti.static(j == 1) else 1 - f.y
        z = f.z if ti.static(k == 1) else 1 - f.z
        total += x * y * z * field[((corner.x + i) * count + corner.y + j) * count + corner.z + k]
    return total


@ti.kernel
def carry(
    back: ti.types.ndarray(),
    onward: ti.types.ndarray(),
    source: ti.types.ndarray(),
    target: ti.types.ndarray(),
    level: ti.types.ndarray(),
    share: float,
    origin: float,
    step: float,
    count: int,
    coarse_count: int,
):
    """Blend both distances, each at the place where a point of the lattice comes from or goes."""
    for n in range(level.shape[0]):
        place = ti.Vector([n // (count * count), (n // count) % count, n % count])
        along = ti.cast(place, float) / (REFINEMENT * COARSENING)
        here = (interpolated(back, along, coarse_count) - origin) / step
        there = (interpolated(onward, along, coarse_count) - origin) / step
        level[n] = (1 - share) * interpolated(source, here, count)
        level[n] += share * interpolated(target, there, count)
