"""B-spline interpolation between particles and grid nodes (algorithm 2.1).

Nodes are stored in one flat array, z fastest. The grid carries `PADDING` extra nodes on each side,
which never hold mass or velocity: a stencil may reach over the border without a branch, and nodes
outside the domain count for nothing.
"""

from dataclasses import dataclass

import taichi as ti

from morph_engine.backend import CPU_CHUNK_COUNT
from morph_engine.errors import ConfigError

PADDING = 2
LARGEST_INDEX = 2**27 - 1  # of a node, all private grids together


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

    def __post_init__(self) -> None:
        """Refuse a grid whose node numbers do not fit.

        Raises:
            ConfigError: The private grids hold more than `LARGEST_INDEX` nodes.
        """
        if self.node_count * CPU_CHUNK_COUNT > LARGEST_INDEX:
            raise ConfigError(
                f"A grid of {self.nodes} nodes per axis is too large.",
                "Use a larger grid spacing or a smaller domain.",
            )

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
        result = ti.Vector([-0.5 * o * o, f * (1.5 * f - 2), -o * (1.5 * o - 2), 0.5 * f * f])
    else:
        f = offset - 1.0
        result = ti.Vector([f - 0.5, -2 * f, f + 0.5])
    return result


@ti.func
def row(corner: int, i: int, j: int, grid: ti.template()):
    """Flat index of the first node of row (i, j), along z, of the stencil at `corner`.

    The mask changes no index: it shows the compiler that an index cannot overflow, so that the
    nodes of a row lie side by side and can be one vector.
    """
    return (corner + (i * grid.nodes + j) * grid.nodes) & LARGEST_INDEX


@ti.func
def read_row(nodes: ti.template(), first: int, width: ti.template()):
    """The node values (4 numbers each) of a row as one vector."""
    row_nodes = [nodes[first + k] for k in range(width)]
    return ti.Vector([node[c] for node in row_nodes for c in range(4)])


@ti.func
def make_row(w, constant, linear, offset: float, width: ti.template()):
    """The row w_k (constant + linear (k - offset)) of node values."""
    values = [w[k] * (constant + linear * (k - offset)) for k in range(width)]
    return ti.Vector([value[c] for value in values for c in range(4)])


@ti.func
def add_row(nodes: ti.template(), first: int, share, width: ti.template(), atomic: ti.template()):
    """Add to the node values of a row."""
    if ti.static(atomic):
        for k in ti.static(range(width)):
            ti.atomic_add(nodes[first + k], ti.Vector([share[4 * k + c] for c in range(4)]))
    else:
        total = read_row(nodes, first, width) + share
        for k in ti.static(range(width)):
            nodes[first + k] = ti.Vector([total[4 * k + c] for c in range(4)])


@ti.func
def row_moments(nodes: ti.template(), first: int, w, width: ti.template()):
    """Sums of w_k n_k and of (k - 1) w_k n_k over the nodes n_k of a row."""
    low, high = w[0] * nodes[first], w[2] * nodes[first + 2]
    total, moment = low + w[1] * nodes[first + 1] + high, high - low
    if ti.static(width == 4):
        last = w[3] * nodes[first + 3]
        total += last
        moment += 2 * last
    return total, moment


@ti.func
def plane_moments(nodes: ti.template(), corner: int, i: int, w, grid: ti.template()):
    """Sums of w_j r_j and of (j - 1) w_j r_j over the rows r_j of a plane."""
    width = ti.static(grid.width)
    low = w[0] * read_row(nodes, row(corner, i, 0, grid), width)
    high = w[2] * read_row(nodes, row(corner, i, 2, grid), width)
    middle = w[1] * read_row(nodes, row(corner, i, 1, grid), width)
    total, moment = low + middle + high, high - low
    if ti.static(width == 4):
        last = w[3] * read_row(nodes, row(corner, i, 3, grid), width)
        total += last
        moment += 2 * last
    return total, moment


@ti.func
def zero_sums(lanes: ti.template()):
    """Sums over a stencil, for `accumulate`."""
    return ti.Matrix.zero(float, 2, lanes)


@ti.func
def accumulate(sums: ti.template(), memory: int, weight: float, values):
    """Add weight * values to the sums in row `memory`, see `in_memory`."""
    for lane in ti.static(range(values.n)):
        sums[memory, lane] = sums[memory, lane] + weight * values[lane]


@ti.func
def in_memory(offset):
    """Zero, but the compiler cannot know: a matrix indexed by it is kept in memory.

    LLVM makes vector instructions of consecutive stores; long sums in registers it leaves scalar.
    """
    return ti.cast(offset.sum() > 100, int)


@ti.func
def vector(sums: ti.template(), memory: int):
    """The first three sums as a vector."""
    return ti.Vector([sums[memory, 0], sums[memory, 1], sums[memory, 2]])


@ti.func
def total(sums: ti.template(), memory: int):
    """All sums together."""
    result = sums[memory, 0]
    for lane in ti.static(range(1, sums.m)):
        result += sums[memory, lane]
    return result
