"""Multigrid: an approximate inverse of the pressure equation, by ever coarser grids.

The equation is a graph Laplacian: rows are nodes that take part, weights belong to the faces
between them. Rows of a coarser grid stand for the two by two by two rows inside them, corrections
are constant there, and the weight of a coarse face is half the sum of the fine ones in it (their
area is four times as large, and so far apart twice as long). A V-cycle sweeps once over even and
odd rows before each coarser level and once over odd and even rows after it, by Gauss-Seidel: a
symmetric operator, as conjugate gradients need (McAdams et al. 2010). Rows gather from rows of the
other parity, so the number of threads changes no bit.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from morph_engine import backend
from morph_engine.unfilled_arrays import unfilled

SMALLEST_SHARED_CPU = 96
SMALLEST_SHARED_GPU = 11
"""Threads share out the rows of a grid with at least so many nodes an axis. To wake them takes some
60 us on a CPU, in which one thread sweeps over a few thousand rows."""

SELF_WEIGHT = 1e-5
"""Of a row with itself, which makes a solution unique where no wall holds the pressure."""

MARKED = -2
"""Index of a node that shall have a row."""

System: Any = ti.types.argpack(
    **dict.fromkeys(("index", "node", "line", "parent", "odd"), ti.types.ndarray()),
    **dict.fromkeys(("counts", "first", "per_axis"), ti.types.ndarray()),
    **dict.fromkeys(("neighbors", "weights", "children"), ti.types.ndarray()),
    **dict.fromkeys(("self_weight", "diagonal", "r", "z"), ti.types.ndarray()),
)
"""All levels one after the other. Of nodes: their row, or -1. Of lines of nodes, at one level after
the other: where their rows begin. Of rows: the node, the coarser row that stands for it, 1 where
the sum of its coordinates is odd. Of levels: how many rows they have, where their nodes and rows
begin, nodes per axis. Of rows: six neighbours (itself where there is none), the weights of the
faces, eight finer rows or -1, the weight with itself, the diagonal, right-hand side and
solution."""


@dataclass(frozen=True)
class Levels:
    """The grids, the finest first: a compile-time constant of the kernels.

    Attributes:
        resolutions: Nodes per axis of each.
        offsets: Where its nodes, and its rows, begin in the arrays.
        shared: How many of them threads share out, if any; what is coarser is done by one.
    """

    resolutions: tuple[int, ...]
    offsets: tuple[int, ...]
    shared: int

    @property
    def count(self) -> int:
        """Number of grids."""
        return len(self.resolutions)

    @property
    def serial(self) -> bool:
        """Whether one thread does it all."""
        return self.shared == 0

    @property
    def size(self) -> int:
        """Nodes of all."""
        return self.offsets[-1] + self.resolutions[-1] ** 3


def levels_of(resolution: int) -> Levels:
    """Grids from so many nodes per axis to one of a single node, which holds the mean pressure."""
    resolutions, offsets = [resolution], [0]
    while resolutions[-1] > 1:
        offsets.append(offsets[-1] + resolutions[-1] ** 3)
        resolutions.append(-(-resolutions[-1] // 2))
    smallest = SMALLEST_SHARED_CPU if backend.active().on_cpu else SMALLEST_SHARED_GPU
    shared = sum(nodes >= smallest for nodes in resolutions[:-1])
    return Levels(tuple(resolutions), tuple(offsets), shared)


def new_system(levels: Levels) -> Any:
    """Arrays of a system without rows."""
    device, n = backend.active(), levels.size
    with unfilled():  # few nodes have rows
        rows = {
            **{name: device.integers(n) for name in ("node", "parent", "odd")},
            **{name: device.scalars(n) for name in ("self_weight", "diagonal", "r", "z")},
            "neighbors": device.integer_vectors(n, 6),
            "weights": device.vectors(n, 6),
            "children": device.integer_vectors(n, 8),
        }
    system = System(
        **rows,
        **{name: device.integers(levels.count) for name in ("counts", "first", "per_axis")},
        index=device.integers(n),
        line=device.integers(levels.resolutions[0] ** 2),
    )
    system.first.from_numpy(np.array(levels.offsets, np.int32))
    system.per_axis.from_numpy(np.array(levels.resolutions, np.int32))
    system.index.fill(-1)
    return system


@ti.func
def place_lines(system: ti.template(), first: int, lines: int):
    """Where each line of nodes has its rows, given how many; returns one past the last: serial."""
    row = first
    for k in range(lines):
        count = system.line[k]
        system.line[k] = row
        row += count
    return row


@ti.func
def list_coarse_rows(system: ti.template(), levels: ti.template()):
    """List the rows of the coarser levels from those of the finest, in the order of their nodes.

    Those that threads share out mark their nodes first; the others are one serial task.
    """
    for level in ti.static(range(1, levels.shared + 1)):
        fine, coarse = ti.static(levels.offsets[level - 1], levels.offsets[level])
        n, m = ti.static(levels.resolutions[level - 1], levels.resolutions[level])
        for row in range(coarse, coarse + system.counts[level]):  # those of the step before
            system.index[system.node[row]] = -1
        for row in range(fine, fine + system.counts[level - 1]):
            system.index[parent_of(row, fine, coarse, n, system)] = MARKED
        for line in range(m * m):
            found = 0
            for i in range(coarse + line * m, coarse + line * m + m):
                found += int(system.index[i] == MARKED)
            system.line[line] = found
        ti.loop_config(serialize=True)
        for _ in range(1):
            system.counts[level] = place_lines(system, coarse, m * m) - coarse
        for line in range(m * m):
            row = system.line[line]
            for i in range(coarse + line * m, coarse + line * m + m):
                if system.index[i] == MARKED:
                    system.index[i] = row
                    system.node[row] = i
                    row += 1
    ti.loop_config(serialize=True)
    for _ in range(1):
        for level in range(levels.shared + 1, levels.count):
            fine, coarse = system.first[level - 1], system.first[level]
            for row in range(coarse, coarse + system.counts[level]):
                system.index[system.node[row]] = -1
            found = 0
            for row in range(fine, fine + system.counts[level - 1]):
                cell = parent_of(row, fine, coarse, system.per_axis[level - 1], system)
                if system.index[cell] < 0:
                    system.index[cell] = coarse + found
                    system.node[coarse + found] = cell
                    found += 1
            system.counts[level] = found


@ti.func
def place_of(row: int, first: int, n: int, system: ti.template()):
    """Where the node of a row is on the grid of its level, with n nodes per axis."""
    k = system.node[row] - first
    return ti.Vector([k // (n * n), (k // n) % n, k % n])


@ti.func
def parent_of(row: int, fine: int, coarse: int, n: int, system: ti.template()):
    """The coarser node that stands for the node of a row."""
    half, m = place_of(row, fine, n, system) // 2, (n + 1) // 2
    return coarse + (half.x * m + half.y) * m + half.z


@ti.func
def relate_to_coarser(row: int, fine: int, coarse: int, n: int, system: ti.template()):
    """The coarser row that stands for a row, and its parity."""
    system.parent[row] = system.index[parent_of(row, fine, coarse, n, system)]
    system.odd[row] = place_of(row, fine, n, system).sum() % 2


@ti.func
def assemble_coarse(row: int, fine: int, coarse: int, n: int, system: ti.template()):
    """Children and weights of a coarser row, where finer grids have n nodes per axis."""
    low = 2 * place_of(row, coarse, (n + 1) // 2, system)
    for c in range(8):
        at = low + ti.Vector([c >> 2, c >> 1 & 1, c & 1])
        child = -1
        if at.max() < n:
            child = system.index[fine + (at.x * n + at.y) * n + at.z]
        system.children[row][c] = child
    total, finest = 0.0, 0.0
    for f in range(6):
        axis, ahead = f >> 1, 1 - (f & 1)
        weight, other = 0.0, row
        for c in range(8):
            if (c >> (2 - axis) & 1) == ahead:
                child = system.children[row][c]
                if child >= 0:
                    if system.weights[child][f] > 0:
                        weight += 0.5 * system.weights[child][f]
                        other = system.parent[system.neighbors[child][f]]
        system.weights[row][f] = weight
        system.neighbors[row][f] = other
        total += weight
    for c in range(8):
        child = system.children[row][c]
        if child >= 0:
            finest += system.self_weight[child]
    system.self_weight[row] = finest
    system.diagonal[row] = total + finest


@ti.func
def assemble_coarser(system: ti.template(), levels: ti.template()):
    """The coarser levels from the finest: those that threads share out, then the others."""
    for level in ti.static(range(1, levels.shared + 1)):
        fine, coarse = ti.static(levels.offsets[level - 1], levels.offsets[level])
        n = ti.static(levels.resolutions[level - 1])
        for row in range(fine, fine + system.counts[level - 1]):
            relate_to_coarser(row, fine, coarse, n, system)
        for row in range(coarse, coarse + system.counts[level]):
            assemble_coarse(row, fine, coarse, n, system)
    ti.loop_config(serialize=True)
    for _ in range(1):
        for level in range(levels.shared + 1, levels.count):
            fine, coarse = system.first[level - 1], system.first[level]
            n = system.per_axis[level - 1]
            for row in range(fine, fine + system.counts[level - 1]):
                relate_to_coarser(row, fine, coarse, n, system)
            for row in range(coarse, coarse + system.counts[level]):
                assemble_coarse(row, fine, coarse, n, system)


@ti.func
def relaxed(system: ti.template(), row: int):
    """The solution of a row for which its equation holds, given its neighbours."""
    total = system.r[row]
    for f in range(6):
        total += system.weights[row][f] * system.z[system.neighbors[row][f]]
    return total / system.diagonal[row]


@ti.func
def smooth_from_zero(system: ti.template(), row: int):
    """The solution of a row after a sweep over even rows and then odd ones, from zero."""
    total = system.r[row]
    if system.odd[row]:
        for f in range(6):
            other = system.neighbors[row][f]
            total += system.weights[row][f] * system.r[other] / system.diagonal[other]
    system.z[row] = total / system.diagonal[row]


@ti.func
def restrict(system: ti.template(), row: int):
    """The right-hand side of a coarser row: what its finer rows lack."""
    total = 0.0
    for c in range(8):
        child = system.children[row][c]
        if child >= 0:
            if not system.odd[child]:  # whose equation does not hold
                change = relaxed(system, child) - system.z[child]
                total += system.diagonal[child] * change
    system.r[row] = total


@ti.func
def smooth_odd(system: ti.template(), row: int):
    """A sweep over odd rows, with the correction of the coarser grid in their even neighbours."""
    if system.odd[row]:
        total = system.r[row]
        for f in range(6):
            other = system.neighbors[row][f]
            total += system.weights[row][f] * (system.z[other] + system.z[system.parent[other]])
        system.z[row] = total / system.diagonal[row]


@ti.func
def smooth_even(system: ti.template(), row: int):
    """A sweep over even rows, which follow from the odd ones alone."""
    if not system.odd[row]:
        system.z[row] = relaxed(system, row)


@ti.func
def v_cycle(system: ti.template(), levels: ti.template()):
    """z = an approximate solution of A z = r on the finest level, linear and symmetric in r.

    Its last sweep, over the even rows of the finest level, is left to the caller. Coarse levels are
    one serial task: to share so little work out takes longer than to do it.
    """
    for level in ti.static(range(levels.shared)):
        first, coarse = ti.static(levels.offsets[level], levels.offsets[level + 1])
        for row in range(first, first + system.counts[level]):
            smooth_from_zero(system, row)
        for row in range(coarse, coarse + system.counts[level + 1]):
            restrict(system, row)
    ti.loop_config(serialize=True)
    for _ in range(1):
        for level in range(levels.shared, levels.count - 1):
            first, coarse = system.first[level], system.first[level + 1]
            for row in range(first, first + system.counts[level]):
                smooth_from_zero(system, row)
            for row in range(coarse, coarse + system.counts[level + 1]):
                restrict(system, row)
        last = ti.static(levels.offsets[levels.count - 1])
        system.z[last] = system.r[last] / system.diagonal[last]
        for back in range(levels.count - 1 - levels.shared):
            level = levels.count - 2 - back
            first = system.first[level]
            for row in range(first, first + system.counts[level]):
                smooth_odd(system, row)
            if level > 0:
                for row in range(first, first + system.counts[level]):
                    smooth_even(system, row)
    for level in ti.static(range(levels.shared - 1, -1, -1)):
        first = ti.static(levels.offsets[level])
        for row in range(first, first + system.counts[level]):
            smooth_odd(system, row)
        if ti.static(level > 0):
            for row in range(first, first + system.counts[level]):
                smooth_even(system, row)
