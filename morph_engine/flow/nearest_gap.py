"""Distance from each particle to the nearest other one.

Lengths are in the unit of the grid that is given, written [dx]: in the method `flow` its own cells.
"""

from typing import Any

import taichi as ti

from morph_engine import backend
from morph_engine.flow.cell_list import (
    LANES,
    CellList,
    cell_of,
    column_of,
    load_lanes,
    zero_lanes,
)

FAR = 1e30


class NearestGap:
    """Finds how far each particle is from the nearest other one.

    Args:
        cells: Lists the particles.
    """

    def __init__(self, cells: CellList) -> None:
        self._cells = cells
        self._gap = backend.active().scalars(cells.order.shape[0])

    def find(self, x: Any, bound: float) -> Any:
        """The distances [dx], device array, shape [n]; inf where they are not below the bound.

        Args:
            x: Positions [dx], device array, shape [n, 3].
            bound: Where to stop looking [dx].
        """
        cells = self._cells
        cells.build(x)
        find_gaps(
            x, self._gap, cells.box, cells.first, *cells.columns,
            cells.origin, cells.edge, bound,
        )  # fmt: skip
        return self._gap


@ti.kernel
def find_gaps(
    x: ti.types.ndarray(),
    gap: ti.types.ndarray(),
    box: ti.types.ndarray(),
    first: ti.types.ndarray(),
    x_column: ti.types.ndarray(),
    y_column: ti.types.ndarray(),
    z_column: ti.types.ndarray(),
    origin: float,
    edge: float,
    bound: float,
):
    """A particle finds itself, at the distance 0: whoever else is there makes its gap 0."""
    for p in range(x.shape[0]):
        low = cell_of(x[p] - bound, box, origin, edge)
        high = cell_of(x[p] + bound, box, origin, edge)
        least, here = zero_lanes() + bound * bound, zero_lanes()
        for i in range(low.x, high.x + 1):
            for j in range(low.y, high.y + 1):
                row = column_of(i, j, box)
                begin, end = first[row + low.z], first[row + high.z + 1]
                for group in range((end - begin + LANES - 1) // LANES):
                    slot = begin + group * LANES
                    away_x = x[p].x - load_lanes(x_column, slot)
                    away_y = x[p].y - load_lanes(y_column, slot)
                    away_z = x[p].z - load_lanes(z_column, slot)
                    squared = away_x**2 + away_y**2 + away_z**2
                    for lane in ti.static(range(LANES)):
                        square = ti.select(slot + lane < end, squared[lane], FAR)
                        here[lane] += ti.select(square == 0, 1, 0)
                        least[lane] = ti.min(least[lane], ti.select(square == 0, FAR, square))
        nearest = least.min()
        gap[p] = ti.select(nearest < bound * bound, ti.sqrt(nearest), ti.math.inf)
        if here.sum() > 1:
            gap[p] = 0.0
