"""B-spline interpolation between particles and grid nodes (algorithm 2.1).

Nodes are stored in one flat array, z fastest. The grid carries `PADDING` extra nodes on each side,
which never hold mass or velocity: a stencil may reach over the border without a branch, and nodes
outside the domain count for nothing.
"""

from dataclasses import dataclass

import taichi as ti

PADDING = 2


@dataclass(frozen=True)
class Geometry:
    """The background grid, a compile-time constant of every kernel that uses it.

    Attributes:
        dx: Node spacing.
        half_extent: The domain is [-half_extent, half_extent]^3, in the units of dx.
        width: Nodes of a stencil per axis: 4 for cubic splines, 3 for quadratic ones.
    """

    dx: float = 1.0
    half_extent: float = 16.0
    width: int = 4

    @property
    def nodes(self) -> int:
        """Nodes per axis, padding included."""
        return round(2 * self.half_extent / self.dx) + 1 + 2 * PADDING

    @property
    def node_count(self) -> int:
        """Nodes in all, padding included."""
        return self.nodes**3

    @property
    def origin(self) -> float:
        """Coordinate of the lowest node, padding included, along every axis."""
        return -self.half_extent - PADDING * self.dx

    @property
    def affine(self) -> float:
        """The constant c with sum_i w d (x) d = I / c [1/dx^2]."""
        return (3.0 if self.width == 4 else 4.0) / self.dx**2


@ti.func
def base_and_offset(position, grid: ti.template()):
    """Lowest node of a particle's stencil, and the particle's position relative to it in cells.

    Both are clamped so that no particle, wherever it is, addresses memory outside the grid; the
    step reports such a particle as a fault.
    """
    cell = (position - grid.origin) / grid.dx
    base = ti.floor(cell, int) - 1 if ti.static(grid.width == 4) else ti.floor(cell - 0.5, int)
    base = ti.math.clamp(base, 0, grid.nodes - grid.width)
    low = ti.static(1.0 if grid.width == 4 else 0.5)
    return base, ti.math.clamp(cell - base, low, low + 1.0)


@ti.func
def flat_index(node, grid: ti.template()):
    """Position of an integer node in the flat node array."""
    return (node.x * grid.nodes + node.y) * grid.nodes + node.z


@ti.func
def is_inside(i: int, grid: ti.template()):
    """Whether flat node i belongs to the domain, not to the padding."""
    n = ti.static(grid.nodes)
    node = ti.Vector([i // (n * n), (i // n) % n, i % n])
    return node.min() >= PADDING and node.max() < n - PADDING


@ti.func
def weights(offset: float, width: ti.template()):
    """B-spline weights of the `width` nodes of a stencil along one axis; cubic 4, quadratic 3."""
    result = ti.Vector.zero(float, width)
    if ti.static(width == 4):
        f = offset - 1.0
        o = 1.0 - f
        result = ti.Vector(
            [o**3 / 6, f * f * (0.5 * f - 1) + 2 / 3, o * o * (0.5 * o - 1) + 2 / 3, f**3 / 6]
        )
    else:
        f = offset - 1.0
        result = ti.Vector([0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2])
    return result


@ti.func
def slopes(offset: float, width: ti.template()):
    """Derivatives of `weights` by the particle's position in cells."""
    result = ti.Vector.zero(float, width)
    if ti.static(width == 4):
        f = offset - 1.0
        o = 1.0 - f
        result = ti.Vector(
            [-0.5 * o * o, f * (1.5 * f - 2), -o * (1.5 * o - 2), 0.5 * f * f]
        )
    else:
        f = offset - 1.0
        result = ti.Vector([f - 0.5, -2 * f, f + 0.5])
    return result


@ti.func
def weight_and_slope(distance: float, width: ti.template()):
    """B-spline weight and its derivative by the particle's position, at node - particle [cells].

    The same numbers as `weights` and `slopes`, for loops that are not unrolled.
    """
    d = ti.abs(distance)
    sign = ti.select(distance < 0, 1.0, -1.0)
    weight, slope = 0.0, 0.0
    if ti.static(width == 4):
        far = ti.max(2 - d, 0.0)
        weight = ti.select(d < 1, d * d * (0.5 * d - 1) + 2 / 3, far**3 / 6)
        slope = sign * ti.select(d < 1, d * (1.5 * d - 2), -0.5 * far * far)
    else:
        far = ti.max(1.5 - d, 0.0)
        weight = ti.select(d < 0.5, 0.75 - d * d, 0.5 * far * far)
        slope = sign * ti.select(d < 0.5, -2 * d, -far)
    return weight, slope
