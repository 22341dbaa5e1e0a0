"""Distances that a warp carries, blended on the fine lattice."""

import math
from dataclasses import dataclass

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.array_copies import copy_of_front, copy_to_front
from morph_engine.flow.warp import Warp
from morph_engine.mpm.grid import Grid

REFINEMENT = 2
"""Lattice steps of the distances per grid cell."""

COARSENING = 2
"""Grid cells between the points at which a warp is evaluated."""

CELL = REFINEMENT * COARSENING
"""Lattice steps of the distances between these points."""

STEEPEST = 2.0
"""A coarse cell is far from the surface where that would lie beyond it if distances changed so many
times as fast as along a straight line: warps squeeze."""

MARGIN = 3.0
"""Distances are blended so far from the controls [dx]; the body ends nearer to them."""

SAMPLES = 11
"""Shares of the change at which the controls are looked up."""

FAR = 1e3
"""Distance that stands for all beyond [dx]."""


@dataclass(frozen=True, eq=False)
class Level:
    """A level on a box of the fine lattice.

    Attributes:
        corner: The lowest point of the box, counted from the grid's, shape [3].
        values: Of its points [dx], shape [m, n, k].
    """

    corner: NDArray[np.int64]
    values: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Places:
    """Where points of a coarse lattice come from and where they go.

    Attributes:
        corner: Its lowest point, counted from the grid's, shape [3].
        size: Points along each axis, shape [3].
        back: Where they come from [lattice steps from the grid's lowest point], shape [n, 3].
        onward: Where they go, likewise.
    """

    corner: list[int]
    size: list[int]
    back: NDArray[np.float64]
    onward: NDArray[np.float64]


class Carrier:
    """Distances that are carried by a warp and blended, on the device.

    Args:
        warp: What carries them.
        ends: Distances to source and target on the fine lattice [dx], shape [m, m, m] each.
        grid: The grid, whose nodes are every second point of the lattice.

    Attributes:
        corner: The lowest point of the lattice at which they are ever blended, shape [3].
        size: Points from there to the highest along each axis, shape [3].
    """

    def __init__(self, warp: Warp, ends: list[NDArray[np.float32]], grid: Grid) -> None:
        self._warp = warp
        self._grid = grid
        self._ends = [backend.active().upload(end.ravel()) for end in ends]
        self._count = ends[0].shape[0]
        controls = np.concatenate([warp.at(share)[0] for share in np.linspace(0, 1, SAMPLES)])
        low, high = controls.min(axis=0) - MARGIN, controls.max(axis=0) + MARGIN
        first = np.floor((low - grid.origin) / grid.dx).astype(np.int64) - 1
        last = np.ceil((high - grid.origin) / grid.dx).astype(np.int64) + 1
        self.corner: NDArray[np.int64] = REFINEMENT * np.maximum(first, 0)
        end = REFINEMENT * np.minimum(last, grid.resolution - 1)
        self.size: NDArray[np.int64] = end - self.corner + 1
        self._level = backend.active().scalars(int(self.size.prod()))
        self._axis = grid.origin + grid.dx * np.arange(0, grid.resolution + COARSENING, COARSENING)
        most = len(self._axis) ** 3
        self._back, self._onward = (backend.active().vectors(most) for _ in range(2))
        self._coarse = backend.active().scalars(most)
        half_diagonal = math.sqrt(3) / 2 * COARSENING * grid.dx
        self._far = STEEPEST * half_diagonal

    def places(self, share: float) -> Places:
        """Where all that is near the controls comes from and goes; any thread may ask for it."""
        controls, _ = self._warp.at(share)
        corner, axes = [], []
        for low, high in zip(controls.min(axis=0), controls.max(axis=0), strict=True):
            first, last = np.searchsorted(self._axis, (low - MARGIN, high + MARGIN))
            corner.append(max(int(first) - 1, 0))
            axes.append(self._axis[corner[-1] : last + 1])
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        steps = [
            (places - self._grid.origin) * (REFINEMENT / self._grid.dx)
            for places in self._warp.ends(nodes, share)
        ]
        return Places(corner, [len(axis) for axis in axes], *steps)

    def blended(self, share: float, places: Places) -> Level:
        """phi_s around the controls, within `corner` and `size`."""
        for array, points in ((self._back, places.back), (self._onward, places.onward)):
            copy_to_front(array, points)
        first, points = np.array(places.corner), np.array(places.size)
        low = np.maximum(CELL * first, self.corner)
        size = np.minimum(CELL * (first + points - 1) + 1, self.corner + self.size) - low
        carry(
            self._back, self._onward, *self._ends, self._coarse, self._level, share, self._far,
            ti.math.ivec3(self._count), ti.math.ivec3(low), ti.math.ivec3(size),
            ti.math.ivec3(first), ti.math.ivec3(points),
        )  # fmt: skip
        values = copy_of_front(self._level, int(size.prod())).reshape(size)
        return Level(low, values.astype(np.float32, copy=False))


@ti.func
def interpolated(field: ti.template(), along, size):
    """Trilinear interpolation of a field of some size at a place given in lattice steps."""
    inside = ti.math.clamp(along, 0.0, size - 1.001)
    corner = ti.floor(inside, int)
    f = inside - corner
    edges = ti.Matrix.zero(float, 2, 2)
    for i, j in ti.static(ti.ndrange(2, 2)):
        at = ((corner.x + i) * size.y + corner.y + j) * size.z + corner.z
        edges[i, j] = ti.math.mix(field[at], field[at + 1], f.z)
    faces = ti.math.mix(edges[:, 0], edges[:, 1], f.y)
    return ti.math.mix(faces[0], faces[1], f.x)


@ti.func
def blended(
    source: ti.template(), target: ti.template(), back, onward, share: float, size
):  # fmt: skip
    """Both distances, at the places where a point comes from and goes, weighted by the share."""
    first, last = interpolated(source, back, size), interpolated(target, onward, size)
    return ti.math.mix(first, last, share)


@ti.func
def interpolated_in_layer(field: ti.template(), i: int, j: int, k: int, x: float, y: float, size):
    """Bilinear interpolation in one layer of a lattice, x and y beyond its point i, j."""
    near, far = (i * size.y + j) * size.z + k, ((i + 1) * size.y + j) * size.z + k
    return (1 - x) * ((1 - y) * field[near] + y * field[near + size.z]) + x * (
        (1 - y) * field[far] + y * field[far + size.z]
    )


@ti.func
def is_far(coarse: ti.template(), i: int, j: int, k: int, size, far: float):
    """Whether no corner of a cell is near the surface."""
    nearest = abs(coarse[(i * size.y + j) * size.z + k])
    for corner in range(1, 8):
        a, b, c = corner >> 2, corner >> 1 & 1, corner & 1
        value = coarse[((i + a) * size.y + j + b) * size.z + k + c]
        nearest = ti.min(nearest, abs(value))
    return nearest > far


@ti.kernel
def carry(
    back: ti.types.ndarray(),
    onward: ti.types.ndarray(),
    source: ti.types.ndarray(),
    target: ti.types.ndarray(),
    coarse: ti.types.ndarray(),
    level: ti.types.ndarray(),
    share: float,
    far: float,
    size: ti.math.ivec3,
    low: ti.math.ivec3,
    box: ti.math.ivec3,
    corner: ti.math.ivec3,
    coarse_size: ti.math.ivec3,
):
    """Blend both distances, each at the place where a point of the lattice comes from or goes.

    `back` and `onward` hold those places for a box of the coarser lattice, `level` what is blended
    for one of the fine lattice. First it is blended at the points of the coarser one, and what lies
    between them is interpolated where all around is `far` from the surface [dx]: most of it. A row
    of points along z goes from one coarser cell to the next.
    """
    for n in range(coarse_size.x * coarse_size.y * coarse_size.z):
        coarse[n] = blended(source, target, back[n], onward[n], share, size)
    for row in range(box.x * box.y):
        for k in range(box.z):
            level[row * box.z + k] = FAR
        column, line = low.x + row // box.y, low.y + row % box.y
        i, j = column // CELL - corner.x, line // CELL - corner.y
        x, y = (column % CELL) / float(CELL), (line % CELL) / float(CELL)
        if 0 <= i < coarse_size.x - 1 and 0 <= j < coarse_size.y - 1:
            for cell in range(coarse_size.z - 1):
                first = (corner.z + cell) * CELL - low.z
                begin, end = ti.max(first, 0), ti.min(first + CELL, box.z)
                if is_far(coarse, i, j, cell, coarse_size, far):
                    near = interpolated_in_layer(coarse, i, j, cell, x, y, coarse_size)
                    beyond = interpolated_in_layer(coarse, i, j, cell + 1, x, y, coarse_size)
                    for k in range(begin, end):
                        z = (k - first) / float(CELL)
                        level[row * box.z + k] = (1 - z) * near + z * beyond
                else:
                    here = interpolated_in_layer(back, i, j, cell, x, y, coarse_size)
                    there = interpolated_in_layer(onward, i, j, cell, x, y, coarse_size)
                    here_on = interpolated_in_layer(back, i, j, cell + 1, x, y, coarse_size)
                    there_on = interpolated_in_layer(onward, i, j, cell + 1, x, y, coarse_size)
                    for k in range(begin, end):
                        z = (k - first) / float(CELL)
                        level[row * box.z + k] = blended(
                            source, target, (1 - z) * here + z * here_on,
                            (1 - z) * there + z * there_on, share, size,
                        )  # fmt: skip
