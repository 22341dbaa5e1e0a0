"""Scattering particles to grid nodes without races and in a fixed order.

On a CPU a fixed number of chunks of particles each add to a private grid of their own, and the
private grids are summed node by node in their order, so that results do not depend on the number
of threads. On a GPU there is one grid, and additions are atomic.
"""

from typing import Any

import taichi as ti

from morph_engine import backend
from morph_engine.backend import CPU_CHUNK_COUNT, CPU_CHUNK_STRIDE
from morph_engine.mpm.grid import Grid, base_and_offset
from morph_engine.unfilled_arrays import unfilled


class PrivateGrids:
    """Device arrays of a scattering kernel.

    Attributes:
        atomic: Whether there is one grid and additions are atomic.
        partial: Node values of all private grids; 4 values per node, or 1.
        touched: The box of rows that each chunk touches.
    """

    def __init__(self, grid: Grid, values: int = 4) -> None:
        device = backend.active()
        self.atomic: bool = not device.on_cpu
        grids = 1 if self.atomic else CPU_CHUNK_COUNT
        count = grids * grid.node_count
        with unfilled():  # each reaches but a part of the grid
            self.partial: Any = (
                device.scalars(count) if values == 1 else device.vectors(count, values)
            )
        self.touched: Any = device.integer_vectors(grids, 4)


@ti.func
def task_count(x: ti.template(), atomic: ti.template()):
    """Number of tasks that `begin_chunk` splits the particles into."""
    return x.shape[0] if ti.static(atomic) else CPU_CHUNK_COUNT * CPU_CHUNK_STRIDE


@ti.func
def begin_chunk(
    task: int,
    x: ti.template(),
    partial: ti.template(),
    touched: ti.template(),
    grid: ti.template(),
    atomic: ti.template(),
):
    """First and one-past-last particle of a task, and the offset of its cleared private grid.

    Of CPU_CHUNK_STRIDE tasks one has particles, so that each chunk is a thread's own.
    """
    first, last, offset = 0, 0, 0
    if ti.static(atomic):
        first, last = task, task + 1
    elif task % CPU_CHUNK_STRIDE == 0:
        chunk = task // CPU_CHUNK_STRIDE
        size = (x.shape[0] + CPU_CHUNK_COUNT - 1) // CPU_CHUNK_COUNT
        first = ti.min(chunk * size, x.shape[0])
        last = ti.min((chunk + 1) * size, x.shape[0])
        offset = clear_touched_rows(chunk, first, last, x, partial, touched, grid)
    return first, last, offset


@ti.func
def clear_touched_rows(
    chunk: int,
    first: int,
    last: int,
    x: ti.template(),
    partial: ti.template(),
    touched: ti.template(),
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
def touching_chunks(row: int, touched: ti.template(), grid: ti.template(), atomic: ti.template()):
    """The chunks that touch a row of nodes along z, as bits; 0 where no particle reaches."""
    chunks = 1
    if ti.static(not atomic):
        x, y = row // grid.resolution, row % grid.resolution
        chunks = 0
        for chunk in range(CPU_CHUNK_COUNT):
            box = touched[chunk]
            if box[0] <= x and x <= box[1] and box[2] <= y and y <= box[3]:
                chunks |= 1 << chunk
    return chunks


@ti.func
def sum_chunks(
    i: int, chunks: int, partial: ti.template(), grid: ti.template(), atomic: ti.template()
):
    """Sum node i over the private grids of the chunks given as bits, in their order."""
    total = partial[i]
    if ti.static(not atomic):
        total = ti.zero(total)
        for chunk in range(CPU_CHUNK_COUNT):
            if chunks >> chunk & 1:
                total += partial[chunk * grid.node_count + i]
    return total
