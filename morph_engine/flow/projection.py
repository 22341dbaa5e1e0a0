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

from typing import Any

import taichi as ti

from morph_engine import backend
from morph_engine.backend import CPU_CHUNK_COUNT, CPU_CHUNK_STRIDE
from morph_engine.flow.multigrid import (
    SELF_WEIGHT,
    System,
    assemble_coarse,
    levels_of,
    list_coarse_rows,
    new_system,
    smooth_even,
    v_cycle,
)
from morph_engine.mpm.grid import Grid, is_inside

LEAST_FILLED = 0.05
"""Nodes that are to be filled less take no part; matter there is led back by the surface alone."""

NEARLY_EMPTY = 0.1
"""Nodes that are filled less have no more than `CALM` cells a time step of speed: a single particle
cannot be thrown out there."""

CALM = 0.3
GPU_CHUNK_COUNT = 4096

Vectors: Any = ti.types.argpack(
    **dict.fromkeys(("potential", "filled", "x", "p", "q", "partial"), ti.types.ndarray())
)
"""psi of all nodes. Of the rows: a, solution, direction and its image. Sums of chunks of rows."""


class Projection:
    """Arrays and parameters of the pressure solve.

    Args:
        grid: The grid.
        full: Mass of a node deep inside at the density of the source.
        tolerance: Largest residual over the largest right-hand side.
        iterations: Most iterations of conjugate gradients.
    """

    def __init__(
        self, grid: Grid, *, full: float, tolerance: float = 5e-3, iterations: int = 100
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
        self._vectors: Any = Vectors(
            partial=device.vectors(self._chunks, 4),
            **{name: device.scalars(n) for name in ("potential", "filled", "x", "p", "q")},
        )

    def forget(self) -> None:
        """Start from psi = 0, as a resumed run does."""
        self._vectors.potential.fill(0)

    def project(self, nodes: Any, wanted: Any, wanted_next: Any, dt: float, *, gain: float) -> None:
        """Change node velocities in place.

        Args:
            nodes: Velocity and mass, shape [r^3, 4]; zero where no particle reaches.
            wanted: m* at the nodes, shape [r^3], over `full`.
            wanted_next: m*' likewise.
            dt: Time step [s].
            gain: Share of an error of mass that is mended in this step.
        """
        system, vectors, grid = self._system, self._vectors, self.grid
        list_rows(nodes, wanted, wanted_next, system, vectors, self.full, grid)
        list_coarse_rows(system, self._levels)
        count = int(system.counts[0])
        size = -(-count // self._chunks)
        chunks = (count, self._chunks, size, self._stride)
        assemble(nodes, wanted, wanted_next, system, vectors, self.full, gain, dt, grid)
        assemble_coarse(system, self._levels)
        largest = begin(system, vectors, *chunks)
        limit = self.tolerance * max(largest, 1e-12)
        self.iterations_made = 0
        while self.iterations_made < self.iterations:
            first = self.iterations_made == 0
            largest = descend(system, self._levels, vectors, first, *chunks)
            self.iterations_made += 1
            if largest < limit:
                break
        finish(nodes, system, vectors, count, grid)
        calm(nodes, NEARLY_EMPTY * self.full, CALM * grid.dx / dt)


@ti.kernel
def list_rows(
    nodes: ti.types.ndarray(),
    wanted: ti.types.ndarray(),
    wanted_next: ti.types.ndarray(),
    system: System,
    vectors: Vectors,
    full: float,
    grid: ti.template(),
):
    """List the nodes that take part, in their order: serial."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        found = 0
        for i in range(grid.node_count):
            share = ti.max(wanted[i], wanted_next[i])
            system.index[i] = -1
            if share > LEAST_FILLED:
                if is_inside(i, grid):
                    system.index[i] = found
                    system.node[found] = i
                    vectors.filled[found] = ti.min(ti.max(share, nodes[i].w / full), 1.0)
                    found += 1
        system.counts[0] = found


@ti.kernel
def assemble(
    nodes: ti.types.ndarray(),
    wanted: ti.types.ndarray(),
    wanted_next: ti.types.ndarray(),
    system: System,
    vectors: Vectors,
    full: float,
    gain: float,
    dt: float,
    grid: ti.template(),
):
    """The linear system, and its solution of the step before."""
    for k in range(system.counts[0]):
        i = system.node[k]
        change = wanted_next[i] - wanted[i] + gain * (wanted[i] - nodes[i].w / full)
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
        vectors.x[k] = vectors.potential[i]


@ti.func
def applied(vector: ti.template(), system: ti.template(), k: int):
    """Row k of the matrix times a vector."""
    total = system.diagonal[k] * vector[k]
    for f in ti.static(range(6)):
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
def begin(
    system: System, vectors: Vectors, count: int, chunks: int, size: int, stride: int
) -> float:
    """First residual; returns the largest of the right-hand side.

    partial holds (p.q, r.z, r.z before, largest |r|, at first of the rhs) of each chunk.
    """
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk = task // stride
            largest = 0.0
            for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                largest = ti.max(largest, ti.abs(system.r[k]))
                vectors.q[k] = applied(vectors.x, system, k)
            vectors.partial[chunk] = ti.Vector([0.0, 0.0, 0.0, largest])
    for k in range(count):
        system.r[k] -= vectors.q[k]
        vectors.p[k] = 0.0
    return largest_of(vectors, chunks)


@ti.kernel
def descend(
    system: System,
    levels: ti.template(),
    vectors: Vectors,
    first: bool,
    count: int,
    chunks: int,
    size: int,
    stride: int,
) -> float:
    """One iteration of preconditioned conjugate gradients; returns the largest |r|."""
    v_cycle(system, levels)
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk = task // stride
            rz = 0.0
            for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                smooth_even(system, k)
                rz += system.r[k] * system.z[k]
            vectors.partial[chunk][2] = vectors.partial[chunk][1]
            vectors.partial[chunk][1] = rz
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk = task // stride
            beta = chunk_sum(vectors, chunks, 1) / ti.max(chunk_sum(vectors, chunks, 2), 1e-30)
            for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                vectors.p[k] = system.z[k] + (0.0 if first else beta * vectors.p[k])
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk = task // stride
            pq = 0.0
            for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                vectors.q[k] = applied(vectors.p, system, k)
                pq += vectors.p[k] * vectors.q[k]
            vectors.partial[chunk][0] = pq
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk = task // stride
            alpha = chunk_sum(vectors, chunks, 1) / ti.max(chunk_sum(vectors, chunks, 0), 1e-30)
            largest = 0.0
            for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                vectors.x[k] += alpha * vectors.p[k]
                system.r[k] -= alpha * vectors.q[k]
                largest = ti.max(largest, ti.abs(system.r[k]))
            vectors.partial[chunk][3] = largest
    return largest_of(vectors, chunks)


@ti.kernel
def finish(
    nodes: ti.types.ndarray(), system: System, vectors: Vectors, count: int, grid: ti.template()
):
    """Add grad psi to the velocities: the mean over the faces, by how far they are filled."""
    for k in range(count):
        i = system.node[k]
        vectors.potential[i] = vectors.x[k]
        for axis in ti.static(range(3)):
            ahead, behind = system.weights[k][2 * axis], system.weights[k][2 * axis + 1]
            rise = ahead * (vectors.x[system.neighbors[k][2 * axis]] - vectors.x[k])
            rise += behind * (vectors.x[k] - vectors.x[system.neighbors[k][2 * axis + 1]])
            nodes[i][axis] += rise / (grid.dx * ti.max(ahead + behind, 1e-12))


@ti.kernel
def clear(nodes: ti.types.ndarray()):
    """Take velocity and mass from all nodes."""
    for i in range(nodes.shape[0]):
        nodes[i] = ti.Vector.zero(float, 4)


@ti.kernel
def calm(nodes: ti.types.ndarray(), least_mass: float, limit: float):
    """Limit the speed [dx/s] of nodes that hold less than this."""
    for i in range(nodes.shape[0]):
        node = nodes[i]
        if node.w < least_mass:
            speed = node.xyz.norm()
            if speed > limit:
                for axis in ti.static(range(3)):
                    nodes[i][axis] = node[axis] * (limit / speed)
