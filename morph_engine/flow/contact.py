"""What particles feel beside the flow: the surface of the body, and their own strain.

Lengths are in the unit of the grid that is given, written [dx]: in the method `flow` its own cells.
"""

from typing import Any

import taichi as ti

from morph_engine.flow.carrier import REFINEMENT
from morph_engine.mpm.state import Layer

SMALLEST = 1e-12

LayerArrays: Any = ti.types.argpack(**dict.fromkeys(("x", "v", "C", "F"), ti.types.ndarray()))
"""Positions, velocities, affine velocities and deformation gradients of particles."""

Levels: Any = ti.types.argpack(**dict.fromkeys(("now", "then", "box"), ti.types.ndarray()))
"""Levels of two states of the body [dx], on a box of its fine lattice: the lowest point of it, and
its points along each axis."""

DEEPEST = 0.3
"""What the surface presses a particle back in a time step, at most [cells]; less where a frame has
so many steps that a particle would be thrown."""


def layer_arrays(layer: Layer) -> Any:
    """Those arrays of a layer as one argument of a kernel."""
    return LayerArrays(x=layer.x, v=layer.v, C=layer.C, F=layer.F)


@ti.kernel
def extend(
    near: ti.types.ndarray(),
    near_box: ti.types.ndarray(),
    level: ti.types.ndarray(),
    box: ti.types.ndarray(),
    step: float,
):
    """A level from a box to a larger one: outside it is that of the edge, and the distance to it.

    Boxes are as in `Levels`. The distance leads back what is so far from the body.
    """
    size, near_size = ti.Vector([box[4], box[5]]), ti.Vector([near_box[4], near_box[5]])
    low = ti.Vector([near_box[axis] - box[axis] for axis in ti.static(range(3))])
    for row in range(box[3] * size[0]):
        x, y = row // size[0] - low.x, row % size[0] - low.y
        near_x, near_y = ti.math.clamp(x, 0, near_box[3] - 1), ti.math.clamp(y, 0, near_size[0] - 1)
        first, near_first = row * size[1], (near_x * near_size[0] + near_y) * near_size[1]
        square = float((x - near_x) ** 2 + (y - near_y) ** 2)
        for k in range(near_size[1]):
            level[first + low.z + k] = near[near_first + k] + step * ti.sqrt(square)
        for k in range(low.z):
            beyond = ti.sqrt(square + (low.z - k) ** 2)
            level[first + k] = near[near_first] + step * beyond
        last = low.z + near_size[1] - 1
        for k in range(last + 1, size[1]):
            beyond = ti.sqrt(square + (k - last) ** 2)
            level[first + k] = near[near_first + near_size[1] - 1] + step * beyond


@ti.func
def level_and_gradient(levels: ti.template(), share: float, position, grid: ti.template()):
    """Trilinear interpolation of the level between two states of the body, and its gradient."""
    step = ti.static(grid.dx / REFINEMENT)
    low = ti.Vector([levels.box[0], levels.box[1], levels.box[2]])
    size = ti.Vector([levels.box[3], levels.box[4], levels.box[5]])
    along = ti.math.clamp((position - grid.origin) / step - low, 0.0, size - 1.001)
    corner = ti.floor(along, int)
    f = along - corner
    value, gradient = 0.0, ti.Vector.zero(float, 3)
    for n in range(8):
        i, j, k = n >> 2, n >> 1 & 1, n & 1
        at = ((corner.x + i) * size.y + corner.y + j) * size.z + corner.z + k
        phi = (1 - share) * levels.now[at] + share * levels.then[at]
        x, y, z = ti.select(ti.Vector([i, j, k]) == 1, f, 1 - f)
        value += x * y * z * phi
        gradient += phi * ti.Vector([(2 * i - 1) * y * z, (2 * j - 1) * x * z, (2 * k - 1) * x * y])
    return value, gradient / step


@ti.func
def inverse_cube_root(a: float):
    """Of a positive number; quicker than its power."""
    return ti.exp(ti.log(a) * (-1 / 3))


@ti.func
def relaxed(F, kept: float):
    """Elastic strain that yields: b = F F^T, without its change of volume, goes towards I.

    Returns a triangular F of this b, with det F = 1; rotations mean nothing to an isotropic law.
    """
    J = ti.math.clamp(F.determinant(), 0.1, 10.0)
    F_isochoric = inverse_cube_root(J) * F
    b = kept * F_isochoric @ F_isochoric.transpose() + (1 - kept) * ti.Matrix.identity(float, 3)
    xx = ti.sqrt(ti.max(b[0, 0], SMALLEST))
    yx, zx = b[1, 0] / xx, b[2, 0] / xx
    yy = ti.sqrt(ti.max(b[1, 1] - yx * yx, SMALLEST))
    zy = (b[2, 1] - zx * yx) / yy
    zz = ti.sqrt(ti.max(b[2, 2] - zx * zx - zy * zy, SMALLEST))
    triangular = ti.Matrix([[xx, 0.0, 0.0], [yx, yy, 0.0], [zx, zy, zz]])
    return inverse_cube_root(xx * yy * zz) * triangular


@ti.kernel
def prepare(
    layer: LayerArrays,
    volume_ratio: ti.types.ndarray(),
    guidance: ti.types.ndarray(),
    levels: Levels,
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
        phi, gradient = level_and_gradient(levels, share, layer.x[p], grid)
        if phi > -depth:
            slope = gradient.norm()
            deepest = ti.min(4 * firmness, 1.0) * DEEPEST * grid.dx
            excess = ti.min(firmness * (phi + depth) / ti.max(slope, 0.1), deepest)
            velocity -= (excess / dt / ti.max(slope, SMALLEST)) * gradient
        layer.v[p] = velocity
        layer.C[p] *= momentum
        volume_ratio[p] *= layer.F[p].determinant()
        layer.F[p] = relaxed(layer.F[p], elasticity)
