"""Pressure projection with a prescribed change of mass, on the nodes of the MPM grid.

Node velocities u become v = u + grad psi, the closest ones that carry the mass m of each node to
where it shall be (incompressible MPM, Stomakhin et al. 2014, with a divergence that is given)::

    -div(a grad psi) = (m*' - m* + gain (m* - m)) / dt + div(a u)

m* and m*' are the wanted masses before and after the time step. The first term is the flow that the
change of the body asks for; the second closes the loop, so that errors do not add up. a is the
share of a node that is filled, max(m, m*, m*') and at most 1: nothing flows through empty nodes.
Face values are means of two nodes; psi is found by conjugate gradients with a multigrid
preconditioner, from that of the step before.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from morph_engine import backend
from morph_engine.backend import CPU_CHUNK_COUNT, CPU_CHUNK_STRIDE
from morph_engine.flow.multigrid import (
    SELF_WEIGHT,
    System,
    assemble_coarser,
    levels_of,
    list_coarse_rows,
    new_system,
    place_lines,
    smooth_even,
    v_cycle,
)
from morph_engine.flow.node_box import NodeBox
from morph_engine.mpm.grid import Grid
from morph_engine.mpm.grid_size import PADDING
from morph_engine.unfilled_arrays import unfilled

LEAST_FILLED = 0.05
"""Nodes that are to be filled less take no part; matter there is led back by the surface alone.

This and `NEARLY_EMPTY` are shares of `full`; they are less where matter is thin everywhere.
"""

NEARLY_EMPTY = 0.1
"""Nodes that are filled less have no more than `CALM` cells a time step of speed: a single particle
cannot be thrown out there."""

CALM = 0.3
FASTEST = 0.45
"""No node has more than so many cells a time step of speed: where a body changes at once, matter
takes more than one step to follow."""

GPU_CHUNK_COUNT = 4096

Vectors: Any = ti.types.argpack(
    **dict.fromkeys(
        ("body", "reach", "potential", "filled", "x", "p", "q", "partial"), ti.types.ndarray()
    )
)
"""Two boxes, each as its lowest node and one past its highest: of the nodes that shall hold matter,
and of those that it may reach. psi of all nodes. Of the rows: a, solution, direction and its image.
Sums of chunks of rows."""


class Projection:
    """Arrays and parameters of the pressure solve.

    Args:
        grid: The grid.
        full: Mass of a node deep inside at the density of the source.
        tolerance: Largest residual over the largest right-hand side.
        iterations: Most iterations of conjugate gradients.
    """

    def __init__(
        self, grid: Grid, *, full: float, tolerance: float = 1e-2, iterations: int = 100
    ) -> None:
        device = backend.active()
        self.grid = grid
        self.full = full
        self.tolerance = tolerance
        self.iterations = iterations
        self.iterations_made: int = 0
        n = grid.node_count
        self._chunks = CPU_CHUNK_COUNT if device.on_cpu else GPU_CHUNK_COUNT
        self._stride = CPU_CHUNK_STRIDE if device.on_cpu else 1
        self._levels = levels_of(grid.resolution)
        self._system = new_system(self._levels)
        with unfilled():
            rows = {name: device.scalars(n) for name in ("filled", "x", "p", "q")}
        self._vectors: Any = Vectors(
            **rows,
            potential=device.scalars(n),
            body=device.integers(6),
            reach=device.integers(6),
            partial=device.vectors(self._chunks, 4),
        )
        whole = NodeBox.whole(grid.resolution)
        self.look_at(whole, whole)

    def look_at(self, body: NodeBox, reach: NodeBox) -> None:
        """Look at no other nodes than these.

        Args:
            body: The box of all nodes that shall hold matter; those in the padding do not.
            reach: The box of all that matter may give velocity to, and of the body.
        """
        for name, box, margin in (("body", body, PADDING), ("reach", reach, 0)):
            low = np.maximum(box.low, margin)
            high = np.maximum(np.minimum(box.high, self.grid.resolution - margin), low)
            self._vectors[name].from_numpy(np.concatenate([low, high]).astype(np.int32))

    def forget(self) -> None:
        """Start from psi = 0, as a resumed run does."""
        self._vectors.potential.fill(0)

    def clear(self, nodes: Any) -> None:
        """Take velocity and mass, shape [r^3, 4], from all nodes that matter may reach."""
        clear(nodes, self._levels, self._vectors, self.grid)

    def project(
        self,
        nodes: Any,
        masses: Sequence[Any],
        shares: tuple[float, float],
        dt: float,
        gain: float,
        *,
        thinness: float = 1.0,
    ) -> float:
        """Change node velocities in place.

        Args:
            nodes: Velocity and mass, shape [r^3, 4]; zero where no particle reaches.
            masses: Two states of what nodes shall hold, over `full`, shape [r^3] each.
            shares: m* and m*' are so far from the first state to the second.
            dt: Time step [s].
            gain: Share of an error of mass that is mended in this step.
            thinness: What `LEAST_FILLED` and `NEARLY_EMPTY` are multiplied by: below 1 where even
                nodes deep inside hold much less than `full`.

        Returns:
            The largest residual that is left over the largest right-hand side: at most `tolerance`,
            or more where the iterations did not suffice.
        """
        system, vectors, grid = self._system, self._vectors, self.grid
        least = thinness * LEAST_FILLED
        list_rows(nodes, *masses, *shares, least, system, self._levels, vectors, self.full, grid)
        layout = (self._chunks, self._stride)
        largest = assemble(
            nodes,
            *masses,
            *shares,
            system,
            self._levels,
            vectors,
            self.full,
            gain,
            dt,
            *layout,
            grid,
        )
        scale = max(largest, 1e-12)
        self.iterations_made = 0
        while self.iterations_made < self.iterations:
            first = self.iterations_made == 0
            largest = descend(system, self._levels, vectors, first, *layout)
            self.iterations_made += 1
            if largest < self.tolerance * scale:
                break
        nearly_empty = thinness * NEARLY_EMPTY * self.full
        finish(nodes, system, self._levels, vectors, nearly_empty, dt, grid)
        return largest / scale


@ti.func
def wanted(mass: ti.template(), next_mass: ti.template(), share: float, i: int):
    """What node i shall hold at a share of the time between two states."""
    return (1 - share) * mass[i] + share * next_mass[i]


@ti.func
def most_wanted(
    mass: ti.template(), next_mass: ti.template(), share: float, next_share: float, i: int
):
    """The larger of what node i shall hold at two shares of that time."""
    now = wanted(mass, next_mass, share, i)
    return ti.max(now, wanted(mass, next_mass, next_share, i))


@ti.func
def line_count(box: ti.template()):
    """Number of lines of nodes along z in a box."""
    return (box[3] - box[0]) * (box[4] - box[1])


@ti.func
def line_of(k: int, box: ti.template(), grid: ti.template()):
    """First node of line k of a box, and one past its last."""
    width = box[4] - box[1]
    line = ((box[0] + k // width) * grid.resolution + box[1] + k % width) * grid.resolution
    return line + box[2], line + box[5]


@ti.kernel
def clear(nodes: ti.types.ndarray(), levels: ti.template(), vectors: Vectors, grid: ti.template()):
    """Take velocity and mass from the nodes that matter may reach."""
    ti.loop_config(serialize=levels.serial)
    for k in range(line_count(vectors.reach)):
        begin, end = line_of(k, vectors.reach, grid)
        for i in range(begin, end):
            nodes[i] = ti.Vector.zero(float, 4)


@ti.kernel
def list_rows(
    nodes: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    next_mass: ti.types.ndarray(),
    share: float,
    next_share: float,
    least: float,
    system: System,
    levels: ti.template(),
    vectors: Vectors,
    full: float,
    grid: ti.template(),
):
    """List the nodes that take part, in their order, and the coarser rows.

    Every line counts its own, from which follows where each has its rows.
    """
    ti.loop_config(serialize=levels.serial)
    for k in range(system.counts[0]):
        system.index[system.node[k]] = -1
    ti.loop_config(serialize=levels.serial)
    for k in range(line_count(vectors.body)):
        begin, end = line_of(k, vectors.body, grid)
        found = 0
        for i in range(begin, end):
            most = most_wanted(mass, next_mass, share, next_share, i)
            found += int(most > least)
        system.line[k] = found
    ti.loop_config(serialize=True)
    for _ in range(1):
        system.counts[0] = place_lines(system, 0, line_count(vectors.body))
    ti.loop_config(serialize=levels.serial)
    for k in range(line_count(vectors.body)):
        begin, end = line_of(k, vectors.body, grid)
        row = system.line[k]
        for i in range(begin, end):
            most = most_wanted(mass, next_mass, share, next_share, i)
            if most > least:
                system.index[i] = row
                system.node[row] = i
                vectors.filled[row] = ti.min(ti.max(most, nodes[i].w / full), 1.0)
                row += 1
    list_coarse_rows(system, levels)


@ti.kernel
def assemble(
    nodes: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    next_mass: ti.types.ndarray(),
    share: float,
    next_share: float,
    system: System,
    levels: ti.template(),
    vectors: Vectors,
    full: float,
    gain: float,
    dt: float,
    chunks: int,
    stride: int,
    grid: ti.template(),
) -> float:
    """The linear system and its first residual; returns the largest of the right-hand side.

    The solution begins with that of the step before. The mean of the right-hand side is left out:
    what a body has too much of as a whole no flow inside it can mend. partial holds (p.q, r.z,
    r.z before, largest |r|, at first of the right-hand side) of each chunk.
    """
    ti.loop_config(serialize=levels.serial)
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk, sources = task // stride, 0.0
            begin, end = rows_of(chunk, chunks, system)
            for k in range(begin, end):
                i = system.node[k]
                now = wanted(mass, next_mass, share, i)
                then = wanted(mass, next_mass, next_share, i)
                change = then - now + gain * (now - nodes[i].w / full)
                source, total = change * grid.dx**2 / dt, SELF_WEIGHT
                for f in ti.static(range(6)):
                    axis, sign = ti.static(f // 2, 1 - 2 * (f % 2))
                    step = ti.static(sign * grid.resolution ** (2 - axis))
                    other = system.index[i + step]
                    weight = 0.0
                    if other >= 0:
                        weight = 0.5 * (vectors.filled[k] + vectors.filled[other])
                        flow = 0.5 * (nodes[i][axis] + nodes[i + step][axis])
                        source += sign * weight * flow * grid.dx
                    else:
                        other = k
                    system.neighbors[k][f] = other
                    system.weights[k][f] = weight
                    total += weight
                system.r[k] = source
                system.diagonal[k] = total
                system.self_weight[k] = SELF_WEIGHT
                vectors.x[k] = vectors.potential[i]
                sources += source
            vectors.partial[chunk] = ti.Vector([0.0, sources, 0.0, 0.0])
    assemble_coarser(system, levels)
    ti.loop_config(serialize=levels.serial)
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk, largest = task // stride, 0.0
            mean = chunk_sum(vectors, chunks, 1) / ti.max(system.counts[0], 1)
            begin, end = rows_of(chunk, chunks, system)
            for k in range(begin, end):
                source = system.r[k] - mean
                largest = ti.max(largest, ti.abs(source))
                system.r[k] = source - applied(vectors.x, system, k)
            vectors.partial[chunk][3] = largest
    return largest_of(vectors, chunks)


@ti.func
def rows_of(chunk: int, chunks: int, system: ti.template()):
    """The first row of a chunk, and one past its last."""
    size = (system.counts[0] + chunks - 1) // chunks
    return ti.min(chunk * size, system.counts[0]), ti.min((chunk + 1) * size, system.counts[0])


@ti.func
def applied(vector: ti.template(), system: ti.template(), k: int):
    """Row k of the matrix times a vector."""
    total = system.diagonal[k] * vector[k]
    for f in range(6):
        total -= system.weights[k][f] * vector[system.neighbors[k][f]]
    return total


@ti.func
def chunk_sum(vectors: ti.template(), chunks: int, column: ti.template()):
    """Sum a column of the chunks' partial results in their order."""
    total = 0.0
    for c in range(chunks):
        total += vectors.partial[c][column]
    return total


@ti.func
def largest_of(vectors: ti.template(), chunks: int):
    """The largest of what the chunks have found."""
    largest = 0.0
    for _ in range(1):  # by one thread
        for c in range(chunks):
            largest = ti.max(largest, vectors.partial[c][3])
    return largest


@ti.kernel
def descend(
    system: System,
    levels: ti.template(),
    vectors: Vectors,
    first: bool,
    chunks: int,
    stride: int,
) -> float:
    """One iteration of preconditioned conjugate gradients; returns the largest |r|."""
    v_cycle(system, levels)
    ti.loop_config(serialize=levels.serial)
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk, rz = task // stride, 0.0
            begin, end = rows_of(chunk, chunks, system)
            for k in range(begin, end):
                smooth_even(system, k)
                rz += system.r[k] * system.z[k]
            vectors.partial[chunk][2] = vectors.partial[chunk][1]
            vectors.partial[chunk][1] = rz
    ti.loop_config(serialize=levels.serial)
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk = task // stride
            beta = chunk_sum(vectors, chunks, 1) / ti.max(chunk_sum(vectors, chunks, 2), 1e-30)
            begin, end = rows_of(chunk, chunks, system)
            for k in range(begin, end):
                vectors.p[k] = system.z[k] + (0.0 if first else beta * vectors.p[k])
    ti.loop_config(serialize=levels.serial)
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk, pq = task // stride, 0.0
            begin, end = rows_of(chunk, chunks, system)
            for k in range(begin, end):
                vectors.q[k] = applied(vectors.p, system, k)
                pq += vectors.p[k] * vectors.q[k]
            vectors.partial[chunk][0] = pq
    ti.loop_config(serialize=levels.serial)
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk, largest = task // stride, 0.0
            alpha = chunk_sum(vectors, chunks, 1) / ti.max(chunk_sum(vectors, chunks, 0), 1e-30)
            begin, end = rows_of(chunk, chunks, system)
            for k in range(begin, end):
                vectors.x[k] += alpha * vectors.p[k]
                system.r[k] -= alpha * vectors.q[k]
                largest = ti.max(largest, ti.abs(system.r[k]))
            vectors.partial[chunk][3] = largest
    return largest_of(vectors, chunks)


@ti.kernel
def finish(
    nodes: ti.types.ndarray(),
    system: System,
    levels: ti.template(),
    vectors: Vectors,
    nearly_empty: float,
    dt: float,
    grid: ti.template(),
):
    """Add grad psi to the velocities: the mean over the faces, by how far they are filled.

    Then limit the speed of all nodes that matter may reach.
    """
    ti.loop_config(serialize=levels.serial)
    for k in range(system.counts[0]):
        i = system.node[k]
        vectors.potential[i] = vectors.x[k]
        for axis in ti.static(range(3)):
            ahead, behind = system.weights[k][2 * axis], system.weights[k][2 * axis + 1]
            rise = ahead * (vectors.x[system.neighbors[k][2 * axis]] - vectors.x[k])
            rise += behind * (vectors.x[k] - vectors.x[system.neighbors[k][2 * axis + 1]])
            nodes[i][axis] += rise / (grid.dx * ti.max(ahead + behind, 1e-12))
    ti.loop_config(serialize=levels.serial)
    for k in range(line_count(vectors.reach)):
        begin, end = line_of(k, vectors.reach, grid)
        for i in range(begin, end):
            cells = ti.select(nodes[i].w < nearly_empty, CALM, FASTEST)
            limit, squared = cells * grid.dx / dt, nodes[i].xyz.norm_sqr()
            if squared > limit * limit:
                for axis in ti.static(range(3)):
                    nodes[i][axis] *= limit / ti.sqrt(squared)
