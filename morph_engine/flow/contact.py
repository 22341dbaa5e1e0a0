"""What particles feel beside the flow: the surface of the body, and each other."""

import math
from typing import Any

import numpy as np
import taichi as ti

from morph_engine import backend
from morph_engine.flow.carrier import REFINEMENT
from morph_engine.mpm.grid import Grid

SMALLEST = 1e-12

LayerArrays: Any = ti.types.argpack(**dict.fromkeys(("x", "v", "C", "F"), ti.types.ndarray()))
"""Positions, velocities, affine velocities and deformation gradients of particles."""

DEEPEST = 0.3
"""What the surface presses a particle back in a time step, at most [cells]."""

SETTLING = 0.15
"""What a particle is moved by its neighbours in a round, at most [h]."""

RELAXATION = 0.25
"""Share of an overlap that each of two particles makes room for in a round."""


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
        excess = ti.min(firmness * (phi + depth) / ti.max(slope, 0.1), DEEPEST * grid.dx)
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
    """Pairs of particles that are too close move apart, a little at a time.

    The grid keeps density even at the scale of its cells; this keeps it so below.

    Args:
        count: Number of particles.
        grid: The grid, for its extent.
        spacing: Lattice spacing h of the source [dx].
    """

    def __init__(self, count: int, grid: Grid, spacing: float) -> None:
        device = backend.active()
        self.spacing: float = spacing
        self.cells: int = math.ceil((grid.resolution - 1) * grid.dx / spacing)
        self.origin: float = grid.origin
        self._first = device.integers(self.cells**3 + 1)
        self._cell, self._order = device.integers(count), device.integers(count)
        self._move = device.vectors(count)

    def settle(self, x: Any, moved: Any, *, distance: float, most: float) -> None:
        """Move particles closer than `distance` apart, in place.

        Args:
            x: Positions [dx], shape [n, 3].
            moved: What each is moved is added to this [dx], shape [n].
            distance: Below which particles make room [dx].
            most: What they are moved on average, at most [dx].
        """
        edge, cells, first, order = self.spacing, self.cells, self._first, self._order
        list_cells(x, first, self._cell, order, self.origin, edge, cells)
        push(x, self._move, first, order, self.origin, edge, cells, distance)
        longest = SETTLING * self.spacing
        lengths = np.minimum(np.linalg.norm(self._move.to_numpy(), axis=1), longest)
        part = min(1.0, most / max(float(lengths.mean(dtype=np.float64)), SMALLEST))
        shift(x, self._move, moved, longest, part)


@ti.func
def cell_of(position, origin: float, edge: float, cells: int):
    """Cell of a position along each axis."""
    return ti.math.clamp(ti.floor((position - origin) / edge, int), 0, cells - 1)


@ti.kernel
def list_cells(
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


@ti.kernel
def push(
    x: ti.types.ndarray(),
    move: ti.types.ndarray(),
    first: ti.types.ndarray(),
    order: ti.types.ndarray(),
    origin: float,
    edge: float,
    cells: int,
    distance: float,
):
    """How each particle makes room for those closer than `distance`."""
    for p in range(x.shape[0]):
        here = x[p]
        low = cell_of(here - distance, origin, edge, cells)
        high = cell_of(here + distance, origin, edge, cells)
        total = ti.Vector.zero(float, 3)
        for i in range(low.x, high.x + 1):
            for j in range(low.y, high.y + 1):
                row = (i * cells + j) * cells
                for slot in range(first[row + low.z], first[row + high.z + 1]):
                    apart = here - x[order[slot]]
                    squared = apart.norm_sqr()
                    if 0 < squared and squared < distance * distance:
                        length = ti.sqrt(squared)
                        total += (RELAXATION * (distance - length) / length) * apart
        move[p] = total


@ti.kernel
def shift(
    x: ti.types.ndarray(),
    move: ti.types.ndarray(),
    moved: ti.types.ndarray(),
    longest: float,
    part: float,
):
    """Move particles by part of their moves, of which none is longer than `longest`; add up."""
    for p in range(x.shape[0]):
        length = move[p].norm()
        shorter = part * ti.min(length, longest)
        x[p] += (shorter / ti.max(length, SMALLEST)) * move[p]
        moved[p] += shorter
