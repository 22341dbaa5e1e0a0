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

import taichi as ti

from morph_engine import backend

COARSEST = 10
"""The coarsest grid has at most so many nodes an axis."""

SMALLEST_SHARED = 40
"""Threads of a CPU share out the rows of a grid with at least so many nodes an axis."""

SWEEPS = 4
"""Symmetric Gauss-Seidel sweeps on the coarsest grid."""

SELF_WEIGHT = 1e-6
"""Of a row with itself, which makes a solution unique where no wall holds the pressure."""

System: Any = ti.types.argpack(
    **dict.fromkeys(("index", "node", "parent", "odd", "counts"), ti.types.ndarray()),
    **dict.fromkeys(("neighbors", "weights", "children"), ti.types.ndarray()),
    **dict.fromkeys(("diagonal", "r", "z"), ti.types.ndarray()),
)
"""All levels one after the other. Of nodes: their row, or -1. Of rows: the node, the coarser row
that stands for it, 1 where the sum of its coordinates is odd, six neighbours (itself where there is
none), the weights of the faces, eight finer rows or -1, the diagonal, right-hand side and solution.
And how many rows each level has."""


@dataclass(frozen=True)
class Levels:
    """The grids, the finest first: a compile-time constant of the kernels.

    Attributes:
        resolutions: Nodes per axis of each.
        offsets: Where its nodes, and its rows, begin in the arrays.
        shared: How many of them threads share out; what is coarser is done by one.
    """

    resolutions: tuple[int, ...]
    offsets: tuple[int, ...]
    shared: int

    @property
    def count(self) -> int:
        """Number of grids."""
        return len(self.resolutions)

    @property
    def size(self) -> int:
        """Nodes of all."""
        return self.offsets[-1] + self.resolutions[-1] ** 3


def levels_of(resolution: int) -> Levels:
    """Grids from so many nodes per axis to a coarsest one of `COARSEST` or fewer."""
    resolutions, offsets = [resolution], [0]
    while resolutions[-1] > COARSEST:
        offsets.append(offsets[-1] + resolutions[-1] ** 3)
        resolutions.append(-(-resolutions[-1] // 2))
    smallest = SMALLEST_SHARED if backend.active().on_cpu else COARSEST + 1
    shared = max(1, sum(nodes >= smallest for nodes in resolutions[:-1]))
    return Levels(tuple(resolutions), tuple(offsets), shared)


def new_system(levels: Levels) -> Any:
    """Arrays of a system without rows."""
    device, n = backend.active(), levels.size
    return System(
        **{name: device.integers(n) for name in ("index", "node", "parent", "odd")},
        counts=device.integers(levels.count),
        neighbors=device.integer_vectors(n, 6),
        weights=device.vectors(n, 6),
        children=device.integer_vectors(n, 8),
        **{name: device.scalars(n) for name in ("diagonal", "r", "z")},
    )


@ti.kernel
def list_coarse_rows(system: System, levels: ti.template()):
    """List the rows of the coarser levels from those of the finest, in their order: serial."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(levels.offsets[1], levels.size):
            system.index[i] = -1
        for level in ti.static(range(1, levels.count)):
            fine, coarse = ti.static(levels.offsets[level - 1], levels.offsets[level])
            n, m = ti.static(levels.resolutions[level - 1], levels.resolutions[level])
            found = 0
            for k in range(system.counts[level - 1]):
                i = system.node[fine + k] - fine
                at = ti.Vector([i // (n * n), (i // n) % n, i % n])
                half, right = at // 2, at % 2
                cell = coarse + (half.x * m + half.y) * m + half.z
                if system.index[cell] < 0:
                    system.index[cell] = coarse + found
                    system.node[coarse + found] = cell
                    for c in ti.static(range(8)):
                        system.children[coarse + found][c] = -1
                    found += 1
                system.parent[fine + k] = system.index[cell]
                system.odd[fine + k] = (at.x + at.y + at.z) % 2
                child = 4 * right.x + 2 * right.y + right.z
                for c in ti.static(range(8)):
                    if c == child:
                        system.children[system.index[cell]][c] = fine + k
            system.counts[level] = found


@ti.kernel
def assemble_coarse(system: System, levels: ti.template()):
    """Weights of the coarser levels from those of the finest."""
    for level in ti.static(range(1, levels.count)):
        first = ti.static(levels.offsets[level])
        for row in range(first, first + system.counts[level]):
            total = 0.0
            for f in ti.static(range(6)):
                axis, ahead = ti.static(f // 2, 1 - f % 2)
                weight, other = 0.0, row
                for c in ti.static(range(8)):
                    if ti.static((c >> (2 - axis)) % 2 == ahead):
                        child = system.children[row][c]
                        if child >= 0 and system.weights[child][f] > 0:
                            weight += 0.5 * system.weights[child][f]
                            other = system.parent[system.neighbors[child][f]]
                system.weights[row][f] = weight
                system.neighbors[row][f] = other
                total += weight
            system.diagonal[row] = total + SELF_WEIGHT * ti.static(8.0**level)


@ti.func
def relaxed(system: ti.template(), row: int):
    """The solution of a row for which its equation holds, given its neighbours."""
    total = system.r[row]
    for f in ti.static(range(6)):
        total += system.weights[row][f] * system.z[system.neighbors[row][f]]
    return total / system.diagonal[row]


@ti.func
def smooth_from_zero(system: ti.template(), row: int):
    """The solution of a row after a sweep over even rows and then odd ones, from zero."""
    total = system.r[row]
    if system.odd[row]:
        for f in ti.static(range(6)):
            other = system.neighbors[row][f]
            total += system.weights[row][f] * system.r[other] / system.diagonal[other]
    system.z[row] = total / system.diagonal[row]


@ti.func
def restrict(system: ti.template(), row: int):
    """The right-hand side of a coarser row: what its finer rows lack."""
    total = 0.0
    for c in ti.static(range(8)):
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
        for f in ti.static(range(6)):
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
        for level in ti.static(range(levels.shared, levels.count - 1)):
            first, coarse = ti.static(levels.offsets[level], levels.offsets[level + 1])
            for row in range(first, first + system.counts[level]):
                smooth_from_zero(system, row)
            for row in range(coarse, coarse + system.counts[level + 1]):
                restrict(system, row)
        last = ti.static(levels.offsets[levels.count - 1])
        n = system.counts[levels.count - 1]
        for k in range(n):
            system.z[last + k] = 0.0
        for k in range(2 * SWEEPS * n):
            place = k % n
            row = last + (place if (k // n) % 2 == 0 else n - 1 - place)
            system.z[row] = relaxed(system, row)
        for level in ti.static(range(levels.count - 2, levels.shared - 1, -1)):
            first = ti.static(levels.offsets[level])
            for row in range(first, first + system.counts[level]):
                smooth_odd(system, row)
            for row in range(first, first + system.counts[level]):
                smooth_even(system, row)
    for level in ti.static(range(levels.shared - 1, -1, -1)):
        first = ti.static(levels.offsets[level])
        for row in range(first, first + system.counts[level]):
            smooth_odd(system, row)
        if ti.static(level > 0):
            for row in range(first, first + system.counts[level]):
                smooth_even(system, row)
