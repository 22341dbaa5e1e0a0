"""Settling: particles spread more evenly than the grid of the flow can make them.

Lengths are in the unit of the grid that is given, written [dx]: in the method `flow` its own cells.
"""

import math
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.flow.cell_list import (
    LANES,
    CellList,
    cell_of,
    column_of,
    load_lanes,
    sum_lanes,
    zero_lanes,
)
from morph_engine.flow.contact import SMALLEST, Levels, level_and_gradient
from morph_engine.mpm.grid import Grid

LONGEST_MOVE = 0.15
"""What a particle is moved by its neighbours in a round, at most [h]."""

RELAXATION = 0.25
"""Share of an overlap that each of two particles makes room for in a round."""

REACH = 2.0
"""How far particles feel a gap between others [h]."""

FILLING = 0.25
"""What a particle moves in a round where all of one side is missing, some [h]."""

UNEVEN = 0.2
"""Imbalance of its neighbours that a particle bears, where a missing lattice plane makes 0.5."""


class Settling:
    """Particles that are too close move apart, and fill gaps, a little at a time.

    The grid keeps density even at the scale of its cells; this keeps it so below.

    Args:
        count: Number of particles.
        grid: The grid, for its extent.
        spacing: Lattice spacing h of the source [dx].
    """

    def __init__(self, count: int, grid: Grid, spacing: float) -> None:
        self.spacing: float = spacing
        self.grid: Grid = grid
        self.cells: CellList = CellList(count, grid, spacing)
        self._move = backend.active().vectors(count)
        self._length = backend.active().scalars(count)

    def settle(
        self, x: Any, moved: Any, body: Any, *, distance: float, spacing: float, most: float
    ) -> None:
        """Move particles closer than `distance` apart, and those at gaps into them, in place.

        Where all together would be moved more than `most`, those that are to move least stay.

        Args:
            x: Positions [dx], shape [n, 3].
            moved: What each is moved is added to this [dx], shape [n].
            body: Levels of two states and the share between them, see `level_and_gradient`.
            distance: Below which particles make room [dx].
            spacing: Lattice spacing of the particles by now [dx].
            most: What they are moved on average, at most [dx].
        """
        cells = self.cells
        cells.build(x)
        longest = LONGEST_MOVE * self.spacing
        push(
            x, self._move, self._length, cells.box, cells.first, *cells.columns, *body,
            cells.edge, distance, spacing, longest, self.grid,
        )  # fmt: skip
        less = excess_over_mean(self._length.to_numpy().astype(np.float64), most)
        shift(x, self._move, self._length, moved, less)


def excess_over_mean(lengths: NDArray[np.float64], most: float) -> float:
    """What to take off all lengths, none of which gets negative, so that their mean is `most`.

    The mean falls with what is taken off, ever more slowly, along straight pieces: Newton's method
    comes to its root from below in a few steps.

    Args:
        lengths: Shape [n].
        most: What their mean may be; 0 is returned where it is not more.
    """
    less, longer = 0.0, lengths
    while len(longer) and longer.sum() - len(longer) * less > most * len(lengths):
        less = float((longer.sum() - most * len(lengths)) / len(longer))
        still = longer[longer > less]
        if len(still) == len(longer):
            break
        longer = still
    return less


@ti.kernel
def push(
    x: ti.types.ndarray(),
    move: ti.types.ndarray(),
    length: ti.types.ndarray(),
    box: ti.types.ndarray(),
    first: ti.types.ndarray(),
    x_column: ti.types.ndarray(),
    y_column: ti.types.ndarray(),
    z_column: ti.types.ndarray(),
    levels: Levels,
    share: float,
    edge: float,
    distance: float,
    spacing: float,
    longest: float,
    grid: ti.template(),
):
    """How each particle makes room for those closer than `distance`, and fills gaps.

    `length` is that of the move, at most `longest`.

    Neighbours push with w(r) = (1 - r / R)^2. Around a particle in an even fill that sums to zero;
    beside a gap it points into it, down the gradient of concentration (Lind et al. 2012). What is
    outside the body counts as filled: half a space at the distance d pushes with
    2 pi (R / h)^3 / 3 (u^4 / 4 - u^5 / 5), u = 1 - d / R.

    Neighbours are taken LANES at a time, in vector registers of the CPU.
    """
    for p in range(x.shape[0]):
        here, reach = x[p], REACH * spacing
        low = cell_of(here - reach, box, grid.origin, edge)
        high = cell_of(here + reach, box, grid.origin, edge)
        per_reach = 1 / reach
        apart_x, apart_y, apart_z = zero_lanes(), zero_lanes(), zero_lanes()
        uneven_x, uneven_y, uneven_z = zero_lanes(), zero_lanes(), zero_lanes()
        for i in range(low.x, high.x + 1):
            for j in range(low.y, high.y + 1):
                row = column_of(i, j, box)
                begin, end = first[row + low.z], first[row + high.z + 1]
                for group in range((end - begin + LANES - 1) // LANES):
                    slot = begin + group * LANES
                    away_x = here.x - load_lanes(x_column, slot)
                    away_y = here.y - load_lanes(y_column, slot)
                    away_z = here.z - load_lanes(z_column, slot)
                    gap = ti.sqrt(away_x**2 + away_y**2 + away_z**2)
                    per_gap = zero_lanes()
                    for lane in ti.static(range(LANES)):
                        there = slot + lane < end
                        per_gap[lane] = ti.select(there, 1 / ti.max(gap[lane], SMALLEST), 0)
                    w = ti.max(1 - per_reach * gap, 0) ** 2 * per_gap
                    overlap = ti.max(distance - gap, 0) * per_gap
                    uneven_x += w * away_x
                    uneven_y += w * away_y
                    uneven_z += w * away_z
                    apart_x += overlap * away_x
                    apart_y += overlap * away_y
                    apart_z += overlap * away_z
        uneven = ti.Vector([sum_lanes(uneven_x), sum_lanes(uneven_y), sum_lanes(uneven_z)])
        apart = ti.Vector([sum_lanes(apart_x), sum_lanes(apart_y), sum_lanes(apart_z)])
        phi, gradient = level_and_gradient(levels, share, here, grid)
        slope = gradient.norm()
        u = ti.math.clamp(1 + phi / (reach * ti.max(slope, 0.1)), 0.0, 1.0)
        wall = ti.static(2 * math.pi * REACH**3 / 3) * (u**4 / 4 - u**5 / 5)
        uneven -= (wall / ti.max(slope, SMALLEST)) * gradient
        beyond = ti.max(1 - UNEVEN / ti.max(uneven.norm(), SMALLEST), 0.0)
        move[p] = RELAXATION * apart + FILLING * spacing * beyond * uneven
        length[p] = ti.min(move[p].norm(), longest)


@ti.kernel
def shift(
    x: ti.types.ndarray(),
    move: ti.types.ndarray(),
    length: ti.types.ndarray(),
    moved: ti.types.ndarray(),
    less: float,
):
    """Move particles by their moves, of such lengths but shorter by `less`; add up."""
    for p in range(x.shape[0]):
        shorter = ti.max(length[p] - less, 0.0)
        x[p] += (shorter / ti.max(move[p].norm(), SMALLEST)) * move[p]
        moved[p] += shorter
