"""The background grid: its nodes, and where a particle lies among them (algorithm 2.1).

Nodes are stored in one flat array, z fastest. The grid carries `PADDING` extra nodes on each side,
which never hold mass or velocity: a stencil may reach over the border without a branch, and nodes
outside the domain count for nothing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine.backend import CPU_CHUNK_COUNT
from morph_engine.counting_sort import counting_sort
from morph_engine.errors import ConfigError
from morph_engine.mpm.grid_size import PADDING, nodes_per_axis
from morph_engine.sections import GridConfig, Kernel

LARGEST_INDEX = 2**27 - 1  # of a node, all private grids together


@dataclass(frozen=True)
class Grid:
    """The background grid, a compile-time constant of every kernel that uses it.

    Attributes:
        dx: Node spacing.
        half_extent: The domain is [-half_extent, half_extent]^3, in the units of dx.
        width: Nodes of a stencil per axis: 4 for cubic splines, 3 for quadratic ones.
        leaky: Whether particles may be beyond its reach, see `presence`.
    """

    dx: float = 1.0
    half_extent: float = 16.0
    width: int = 4
    leaky: bool = False

    def __post_init__(self) -> None:
        """Refuse a grid whose node numbers do not fit.

        Raises:
            ConfigError: The private grids hold more than `LARGEST_INDEX` nodes.
        """
        if self.node_count * CPU_CHUNK_COUNT > LARGEST_INDEX:
            raise ConfigError(
                f"A grid of {self.resolution} nodes per axis is too large.",
                "Use a larger grid spacing or a smaller domain.",
            )

    @property
    def resolution(self) -> int:
        """Nodes per axis, padding included."""
        return nodes_per_axis(self.half_extent, self.dx)

    @property
    def node_count(self) -> int:
        """Nodes in all, padding included."""
        return self.resolution**3

    @property
    def origin(self) -> float:
        """Coordinate of the lowest node, padding included, along every axis."""
        return -self.half_extent - PADDING * self.dx

    @property
    def affine(self) -> float:
        """The constant c with sum_i w d (x) d = I / c [1/dx^2]."""
        return (3.0 if self.width == 4 else 4.0) / self.dx**2


def make_grid(config: GridConfig, kernel: Kernel) -> Grid:
    """The background grid of a configuration."""
    return Grid(config.dx, config.half_extent, width=4 if kernel == "cubic" else 3)


CELLS_PER_PARTICLE = 64
"""Where particles are spread over more cells, comparing them takes less memory than counting."""


def cell_order(x: NDArray[Any], grid: Grid) -> NDArray[np.intp]:
    """Order of particles at x [dx], shape [n, 3], by grid cell, z fastest.

    Neighbours in space become neighbours in memory.
    """
    cell = np.floor((x - grid.origin) / grid.dx).astype(np.int64)
    key = (cell[:, 0] * grid.resolution + cell[:, 1]) * grid.resolution + cell[:, 2]
    low, count = int(key.min()), int(key.max()) - int(key.min()) + 1
    if count <= CELLS_PER_PARTICLE * len(x):
        return counting_sort(key - low, count)[0].astype(np.intp)
    return np.argsort(key, kind="stable")


def inverse_order(order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Where each particle is in an order, shape [n]."""
    inverse = np.empty_like(order)
    inverse[order] = np.arange(len(order))
    return inverse


@ti.func
def base_and_offset(position, grid: ti.template()):
    """Lowest node of a particle's stencil, and the particle's position relative to it in cells.

    Both are clamped so that no particle, wherever it is, addresses memory outside the grid; the
    step reports such a particle as a fault, and `presence` takes its weights away.
    """
    cell = (position - grid.origin) / grid.dx
    base = ti.floor(cell, int) - 1 if ti.static(grid.width == 4) else ti.floor(cell - 0.5, int)
    base = ti.math.clamp(base, 0, grid.resolution - grid.width)
    low = ti.static(1.0 if grid.width == 4 else 0.5)
    return base, ti.math.clamp(cell - base, low, low + 1.0)


@ti.func
def presence(position, grid: ti.template()):
    """Factor on the weights of a particle: on a leaky grid 0 beyond its reach, else 1.

    It reaches a cell beyond the domain: there the padding ends. Without weights a particle neither
    gives anything to the grid nor takes anything from it: it stays where it is, as in the published
    program, whose cubic weights, at most 1/6 per axis by then, fade over another cell (algorithm
    2.1).
    """
    factor = 1.0
    if ti.static(grid.leaky):
        reach = ti.static(grid.half_extent + grid.dx)
        factor = ti.select(ti.abs(position).max() < reach, 1.0, 0.0)
    return factor


@ti.func
def flat_index(node, grid: ti.template()):
    """Position of an integer node in the flat node array."""
    return (node.x * grid.resolution + node.y) * grid.resolution + node.z


@ti.func
def is_inside(i: int, grid: ti.template()):
    """Whether flat node i belongs to the domain, not to the padding."""
    n = ti.static(grid.resolution)
    node = ti.Vector([i // (n * n), (i // n) % n, i % n])
    return node.min() >= PADDING and node.max() < n - PADDING


@ti.func
def row_index(corner: int, i: int, j: int, grid: ti.template()):
    """Flat index of the first node of row (i, j), along z, of the stencil at `corner`.

    The mask changes no index: it shows the compiler that an index cannot overflow, so that the
    nodes of a row lie side by side and can be one vector.
    """
    return (corner + (i * grid.resolution + j) * grid.resolution) & LARGEST_INDEX
