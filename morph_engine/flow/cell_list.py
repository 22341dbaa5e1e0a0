"""Particles listed by the cell that they are in, so that those near a place are found.

The cells are those of the least box that holds all particles.
"""

import math
from typing import Any

import taichi as ti

from morph_engine import backend
from morph_engine.mpm.grid import Grid
from morph_engine.unfilled_arrays import unfilled

LANES = 8
"""Particles that a kernel looks at in one go: float32 numbers in a vector register of AVX."""

LARGEST_INDEX = 0x3FFFFFFF


class CellList:
    """Cells over the extent of a grid, and the particles in each.

    Args:
        count: Number of particles.
        grid: The grid, for its extent.
        edge: Edge of a cell [dx].

    Attributes:
        origin: Lowest coordinate along every axis of the grid [dx].
        edge: Edge of a cell [dx].
        box: The lowest cell of the box, counted from the origin, and its cells along each axis.
        first: Where the particles of each cell begin in `order`, z fastest, and where they end.
        order: Particles cell by cell.
        columns: Their x, y and z in this order, each followed by LANES numbers without a meaning
            [dx], shape [count + LANES].
    """

    def __init__(self, count: int, grid: Grid, edge: float) -> None:
        device = backend.active()
        self.origin: float = grid.origin
        self.edge: float = edge
        self.box: Any = device.integers(6)
        self._per_axis = math.ceil((grid.resolution - 1) * grid.dx / edge)
        with unfilled():
            self.first: Any = device.integers(self._per_axis**3 + 1)
        self.order: Any = device.integers(count)
        self.columns: list[Any] = [device.scalars(count + LANES) for _ in range(3)]
        self._cell = device.integers(count)

    def build(self, x: Any) -> None:
        """List particles at x [dx], device array, shape [count, 3]."""
        _list_cells(
            x, self.box, self.first, self._cell, self.order, *self.columns,
            self.origin, self.edge, self._per_axis,
        )  # fmt: skip


@ti.func
def cell_of(position, box: ti.template(), origin: float, edge: float):
    """Cell of the box that is nearest to a position, along each axis."""
    cell, low = ti.floor((position - origin) / edge, int), ti.Vector([box[0], box[1], box[2]])
    return ti.math.clamp(cell - low, 0, ti.Vector([box[3], box[4], box[5]]) - 1)


@ti.func
def column_of(i: int, j: int, box: ti.template()):
    """The first cell of a column along z, of which the cells follow one another."""
    return (i * box[4] + j) * box[5]


@ti.func
def zero_lanes():
    """LANES zeros."""
    return ti.Vector.zero(float, LANES)


@ti.func
def load_lanes(column: ti.template(), first: int):
    """The LANES numbers of a column from one on.

    The mask tells the compiler that no index overflows, so that it loads them as one vector.
    """
    start = first & LARGEST_INDEX
    values = zero_lanes()
    for lane in ti.static(range(LANES)):
        values[lane] = column[start + lane]
    return values


@ti.func
def sum_lanes(values):
    """Sum of LANES numbers, by pairs."""
    pairs = [values[lane] + values[lane + 4] for lane in ti.static(range(4))]
    return (pairs[0] + pairs[2]) + (pairs[1] + pairs[3])


@ti.kernel
def _list_cells(
    x: ti.types.ndarray(),
    box: ti.types.ndarray(),
    first: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    order: ti.types.ndarray(),
    x_column: ti.types.ndarray(),
    y_column: ti.types.ndarray(),
    z_column: ti.types.ndarray(),
    origin: float,
    edge: float,
    cells: int,
):
    """List particles cell by cell, by a counting sort, and fill the columns."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        low, high = x[0], x[0]
        for p in range(x.shape[0]):
            low, high = ti.min(low, x[p]), ti.max(high, x[p])
        lowest = ti.math.clamp(ti.floor((low - origin) / edge, int), 0, cells - 1)
        highest = ti.math.clamp(ti.floor((high - origin) / edge, int), 0, cells - 1)
        for axis in ti.static(range(3)):
            box[axis], box[3 + axis] = lowest[axis], highest[axis] - lowest[axis] + 1
        count = box[3] * box[4] * box[5]
        for c in range(count + 1):
            first[c] = 0
        for p in range(x.shape[0]):
            at = cell_of(x[p], box, origin, edge)
            cell[p] = column_of(at.x, at.y, box) + at.z
            first[cell[p]] += 1
        total = 0
        for c in range(count + 1):
            total += first[c]
            first[c] = total
        for q in range(x.shape[0]):
            p = x.shape[0] - 1 - q
            first[cell[p]] -= 1
            order[first[cell[p]]] = p
    for slot in range(order.shape[0]):
        position = x[order[slot]]
        x_column[slot], y_column[slot], z_column[slot] = position.x, position.y, position.z
