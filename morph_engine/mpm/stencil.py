"""Sums over the nodes around a particle, row by row along z, where nodes lie side by side.

Written so that the compiler finds vector instructions: see `accumulate` and `in_memory`.
"""

import taichi as ti

from morph_engine.mpm.grid import row_index


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
    low = w[0] * read_row(nodes, row_index(corner, i, 0, grid), width)
    high = w[2] * read_row(nodes, row_index(corner, i, 2, grid), width)
    middle = w[1] * read_row(nodes, row_index(corner, i, 1, grid), width)
    total, moment = low + middle + high, high - low
    if ti.static(width == 4):
        last = w[3] * read_row(nodes, row_index(corner, i, 3, grid), width)
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
