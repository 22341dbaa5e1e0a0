"""Particles listed by the cell that they are in, so that those near a place are found."""

import math
from typing import Any

import taichi as ti

from morph_engine import backend
from morph_engine.mpm.grid import Grid


class CellList:
    """Cells over the extent of a grid, and the particles in each.

    Args:
        count: Number of particles.
        grid: The grid, for its extent.
        edge: Edge of a cell [dx].

    Attributes:
        origin: Lowest coordinate along every axis [dx].
        edge: Edge of a cell [dx].
        per_axis: Cells along each axis.
        first: Where the particles of each cell begin in `order`, z fastest, and where they end.
        order: Particles cell by cell.
    """

    def __init__(self, count: int, grid: Grid, edge: float) -> None:
        device = backend.active()
        self.origin: float = grid.origin
        self.edge: float = edge
        self.per_axis: int = math.ceil((grid.resolution - 1) * grid.dx / edge)
        self.first: Any = device.integers(self.per_axis**3 + 1)
        self.order: Any = device.integers(count)
        self._cell = device.integers(count)

    def build(self, x: Any) -> None:
        """List particles at x [dx], device array, shape [count, 3]."""
        _list_cells(x, self.first, self._cell, self.order, self.origin, self.edge, self.per_axis)


@ti.func
def cell_of(position, origin: float, edge: float, cells: int):
    """Cell of a position along each axis."""
    return ti.math.clamp(ti.floor((position - origin) / edge, int), 0, cells - 1)


@ti.kernel
def _list_cells(
    x: ti.types.ndarray(),
    first: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    order: ti.types.ndarray(),
    origin: float,
    edge: float,
    cells: int,
):
    """List particles cell by cell: a counting sort, serial."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for c in range(first.shape[0]):
            first[c] = 0
        for p in range(x.shape[0]):
            at = cell_of(x[p], origin, edge, cells)
            cell[p] = (at.x * cells + at.y) * cells + at.z
            first[cell[p]] += 1
        total = 0
        for c in range(first.shape[0]):
            total += first[c]
            first[c] = total
        for q in range(x.shape[0]):
            p = x.shape[0] - 1 - q
            first[cell[p]] -= 1
            order[first[cell[p]]] = p
