"""What particles feel beside the flow: the surface of the body, and each other.

Lengths are in the unit of the grid that is given, written [dx]: in the method `flow` its own cells.
"""

import math
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.flow.carrier import REFINEMENT
from morph_engine.flow.cell_list import CellList, cell_of
from morph_engine.mpm.grid import Grid

SMALLEST = 1e-12

LayerArrays: Any = ti.types.argpack(**dict.fromkeys(("x", "v", "C", "F"), ti.types.ndarray()))
"""Positions, velocities, affine velocities and deformation gradients of particles."""

DEEPEST = 0.3
"""What the surface presses a particle back in a time step, at most [cells]; less where a frame has
so many steps that a particle would be thrown."""

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


@ti.func
def level_and_gradient(
    level: ti.template(),
    next_level: ti.template(),
    share: float,
    position,
    grid: ti.template(),
):
    """Trilinear interpolation of the level between two states of the body, and its gradient."""
    step = ti.static(grid.dx / REFINEMENT)
    count = ti.static(REFINEMENT * (grid.resolution - 1) + 1)
    along = ti.math.clamp((position - grid.origin) / step, 0.0, count - 1.001)
    corner = ti.floor(along, int)
    f = along - corner
    value, gradient = 0.0, ti.Vector.zero(float, 3)
    for i, j, k in ti.static(ti.ndrange(2, 2, 2)):
        at = ((corner.x + i) * count + corner.y + j) * count + corner.z + k
        phi = (1 - share) * level[at] + share * next_level[at]
        x = f.x if ti.static(i == 1) else 1 - f.x
        y = f.y if ti.static(j == 1) else 1 - f.y
        z = f.z if ti.static(k == 1) else 1 - f.z
        value += x * y * z * phi
        gradient += phi * ti.Vector([(2 * i - 1) * y * z, (2 * j - 1) * x * z, (2 * k - 1) * x * y])
    return value, gradient / step


@ti.func
def relaxed(F, kept: float):
    """Elastic strain that yields: b = F F^T, without its change of volume, goes towards I.

    Returns a triangular F of this b, with det F = 1; rotations mean nothing to an isotropic law.
    """
    J = ti.math.clamp(F.determinant(), 0.1, 10.0)
    b = kept * J ** (-2 / 3) * (F @ F.transpose()) + (1 - kept) * ti.Matrix.identity(float, 3)
    xx = ti.sqrt(ti.max(b[0, 0], SMALLEST))
    yx, zx = b[1, 0] / xx, b[2, 0] / xx
    yy = ti.sqrt(ti.max(b[1, 1] - yx * yx, SMALLEST))
    zy = (b[2, 1] - zx * yx) / yy
    zz = ti.sqrt(ti.max(b[2, 2] - zx * zx - zy * zy, SMALLEST))
    return (xx * yy * zz) ** (-1 / 3) * ti.Matrix([[xx, 0.0, 0.0], [yx, yy, 0.0], [zx, zy, zz]])


@ti.kernel
def prepare(
    layer: LayerArrays,
    volume_ratio: ti.types.ndarray(),
    guidance: ti.types.ndarray(),
    level: ti.types.ndarray(),
    next_level: ti.types.ndarray(),
    share: float,
    depth: float,
    firmness: float,
    momentum: float,
    elasticity: float,
    dt: float,
    grid: ti.template(),
):
    """Particles before a time step: what they keep of velocity and strain, and the surface.

    What they lose of their velocity they get of that which the warp asks for, `guidance` [dx/s].
    Changes of volume are the projection's: they go from F to `volume_ratio`, so that matter does
    not resist them. Those less than `depth` [dx] inside the body are pressed back along its normal.
    """
    for p in range(layer.x.shape[0]):
        velocity = momentum * layer.v[p] + (1 - momentum) * guidance[p]
        phi, gradient = level_and_gradient(level, next_level, share, layer.x[p], grid)
        slope = gradient.norm()
        deepest = ti.min(4 * firmness, 1.0) * DEEPEST * grid.dx
        excess = ti.min(firmness * (phi + depth) / ti.max(slope, 0.1), deepest)
        if excess > 0:
            velocity -= (excess / dt / ti.max(slope, SMALLEST)) * gradient
        layer.v[p] = velocity
        layer.C[p] *= momentum
        volume_ratio[p] *= layer.F[p].determinant()
        layer.F[p] = relaxed(layer.F[p], elasticity)


@ti.kernel
def blend(out: ti.types.ndarray(), a: ti.types.ndarray(), b: ti.types.ndarray(), share: float):
    """out = (1 - share) a + share b."""
    for i in range(out.shape[0]):
        out[i] = (1 - share) * a[i] + share * b[i]


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

    def settle(
        self, x: Any, moved: Any, body: Any, *, distance: float, spacing: float, most: float
    ) -> None:
        """Move particles closer than `distance` apart, and those at gaps into them, in place.

        Where all together would be moved more than `most`, those that are to move least stay.

        Args:
            x: Positions [dx], shape [n, 3].
            moved: What each is moved is added to this [dx], shape [n].
            body: Two levels and the share between them, see `level_and_gradient`.
            distance: Below which particles make room [dx].
            spacing: Lattice spacing of the particles by now [dx].
            most: What they are moved on average, at most [dx].
        """
        cells = self.cells
        cells.build(x)
        push(
            x, self._move, cells.first, cells.order, *body,
            cells.edge, cells.per_axis, distance, spacing, self.grid,
        )  # fmt: skip
        longest = LONGEST_MOVE * self.spacing
        lengths = np.minimum(np.linalg.norm(self._move.to_numpy(), axis=1), longest)
        shift(x, self._move, moved, longest, _threshold(lengths.astype(np.float64), most))


def _threshold(lengths: NDArray[np.float64], most: float) -> float:
    """What to take off all lengths, none of which gets negative, so that their mean is `most`."""
    descending = np.append(-np.sort(-lengths[lengths > 0]), 0.0)
    total = np.cumsum(descending)
    count = np.arange(1, len(descending) + 1)
    enough = np.flatnonzero(total - count * descending > most * len(lengths))
    if not len(enough):
        return 0.0
    last = enough[0] - 1
    return float((total[last] - most * len(lengths)) / count[last])


@ti.kernel
def push(
    x: ti.types.ndarray(),
    move: ti.types.ndarray(),
    first: ti.types.ndarray(),
    order: ti.types.ndarray(),
    level: ti.types.ndarray(),
    next_level: ti.types.ndarray(),
    share: float,
    edge: float,
    cells: int,
    distance: float,
    spacing: float,
    grid: ti.template(),
):
    """How each particle makes room for those closer than `distance`, and fills gaps.

    Neighbours push with w(r) = (1 - r / R)^2. Around a particle in an even fill that sums to zero;
    beside a gap it points into it, down the gradient of concentration (Lind et al. 2012). What is
    outside the body counts as filled: half a space at the distance d pushes with
    2 pi (R / h)^3 / 3 (u^4 / 4 - u^5 / 5), u = 1 - d / R.
    """
    for p in range(x.shape[0]):
        here, reach = x[p], REACH * spacing
        low = cell_of(here - reach, grid.origin, edge, cells)
        high = cell_of(here + reach, grid.origin, edge, cells)
        apart, uneven = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        for i in range(low.x, high.x + 1):
            for j in range(low.y, high.y + 1):
                row = (i * cells + j) * cells
                for slot in range(first[row + low.z], first[row + high.z + 1]):
                    away = here - x[order[slot]]
                    squared = away.norm_sqr()
                    if 0 < squared and squared < reach * reach:
                        length = ti.sqrt(squared)
                        uneven += ((1 - length / reach) ** 2 / length) * away
                        apart += (RELAXATION * ti.max(distance - length, 0.0) / length) * away
        phi, gradient = level_and_gradient(level, next_level, share, here, grid)
        slope = gradient.norm()
        u = ti.math.clamp(1 + phi / (reach * ti.max(slope, 0.1)), 0.0, 1.0)
        wall = ti.static(2 * math.pi * REACH**3 / 3) * (u**4 / 4 - u**5 / 5)
        uneven -= (wall / ti.max(slope, SMALLEST)) * gradient
        beyond = ti.max(1 - UNEVEN / ti.max(uneven.norm(), SMALLEST), 0.0)
        move[p] = apart + FILLING * spacing * beyond * uneven


@ti.kernel
def shift(
    x: ti.types.ndarray(),
    move: ti.types.ndarray(),
    moved: ti.types.ndarray(),
    longest: float,
    less: float,
):
    """Move particles by their moves, cut to `longest` and then shortened by `less`; add up."""
    for p in range(x.shape[0]):
        length = move[p].norm()
        shorter = ti.max(ti.min(length, longest) - less, 0.0)
        x[p] += (shorter / ti.max(length, SMALLEST)) * move[p]
        moved[p] += shorter
