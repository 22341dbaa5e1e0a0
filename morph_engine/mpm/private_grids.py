"""Scattering particles to grid nodes without races and in a fixed order.

On a CPU a fixed number of chunks of particles each add to a private grid of their own, and the
private grids are summed node by node in their order, so that results do not depend on the number
of threads. On a GPU there is one grid, and additions are atomic.
"""

from typing import Any

import taichi as ti

from morph_engine import backend
from morph_engine.mpm.grid import Grid, base_and_offset


class PrivateGrids:
    """Device arrays of a scattering kernel, and how it splits its particles.

    Args:
        particle_count: Number of particles.
        grid: Background grid.
        values: Numbers per node, 4 or 1.
    """

    def __init__(self, particle_count: int, grid: Grid, values: int = 4) -> None:
        device = backend.active()
        self.atomic: bool = not device.on_cpu
        self.chunk_count, self.chunk_size = device.chunks(particle_count)
        grids = self.chunk_count if device.on_cpu else 1
        node_count = grids * grid.node_count
        self.partial: Any = (
            device.scalars(node_count) if values == 1 else device.vectors(node_count, values)
        )
        self.touched: Any = device.integer_vectors(grids, 4)


@ti.func
def chunk_bounds(chunk: int, chunk_size: int, count: int):
    """First and one-past-last item of a chunk."""
    return ti.min(chunk * chunk_size, count), ti.min((chunk + 1) * chunk_size, count)


@ti.func
def clear_touched_rows(
    chunk: int,
    first: int,
    last: int,
    x: ti.template(),
    touched: ti.template(),
    partial: ti.template(),
    grid: ti.template(),
):
    """Clear the rows of a chunk's private grid that its points reach; returns its offset."""
    nodes, width = ti.static(grid.resolution, grid.width)
    low, high = ti.Vector([nodes, nodes]), ti.Vector([-1, -1])
    for p in range(first, last):
        base, _ = base_and_offset(x[p], grid)
        low = ti.min(low, base.xy)
        high = ti.max(high, base.xy + width - 1)
    touched[chunk] = ti.Vector([low.x, high.x, low.y, high.y])
    offset = chunk * nodes**3
    for i in range(low.x, high.x + 1):
        plane = offset + i * nodes**2
        for node in range(plane + low.y * nodes, plane + (high.y + 1) * nodes):
            partial[node] = ti.zero(partial[node])
    return offset


@ti.func
def touching_chunks(
    row: int,
    touched: ti.template(),
    chunk_count: int,
    grid: ti.template(),
    atomic: ti.template(),
):
    """The chunks that claimed a row of nodes along z, as bits; 0 where no particle reaches."""
    chunks = 1
    if ti.static(not atomic):
        x, y = row // grid.resolution, row % grid.resolution
        chunks = 0
        for chunk in range(chunk_count):
            claim = touched[chunk]
            if claim[0] <= x and x <= claim[1] and claim[2] <= y and y <= claim[3]:
                chunks |= 1 << chunk
    return chunks


@ti.func
def sum_chunks(
    i: int,
    chunks: int,
    partial: ti.template(),
    chunk_count: int,
    grid: ti.template(),
    atomic: ti.template(),
):
    """Sum node i over the private grids of the chunks given as bits, in their order."""
    total = partial[i]
    if ti.static(not atomic):
        total = ti.zero(total)
        for chunk in range(chunk_count):
            if chunks >> chunk & 1:
                total += partial[chunk * grid.node_count + i]
    return total
