"""Pressure projection with a prescribed change of mass, on the nodes of the MPM grid.

Node velocities u become v = u + grad psi, the closest ones that carry the mass m of each node to
where it shall be (incompressible MPM, Stomakhin et al. 2014, with a divergence that is given)::

    -div(a grad psi) = (m*' - m* + gain (m* - m)) / dt + div(a u)

m* and m*' are the wanted masses before and after the time step. The first term is the flow that the
change of the body asks for; the second closes the loop, so that errors do not add up. a is the
share of a node that is filled, max(m, m*, m*') and at most 1: nothing flows through empty nodes.
Face values are means of two nodes; psi is found by conjugate gradients, from that of the step
before.
"""

from typing import Any

import taichi as ti

from morph_engine import backend
from morph_engine.backend import CPU_CHUNK_COUNT, CPU_CHUNK_STRIDE
from morph_engine.mpm.grid import Grid, is_inside

LEAST_FILLED = 0.05
"""Nodes that are to be filled less take no part; matter there is led back by the surface alone."""

NEARLY_EMPTY = 0.1
"""Nodes that are filled less have no more than `CALM` cells a time step of speed: a single particle
cannot be thrown out there."""

CALM = 0.3
GPU_CHUNK_COUNT = 4096
BATCH = 8
"""Iterations between two looks at the residual."""

Arrays: Any = ti.types.argpack(
    **dict.fromkeys(("index", "potential"), ti.types.ndarray()),
    **dict.fromkeys(("node", "neighbors", "weights", "filled"), ti.types.ndarray()),
    **dict.fromkeys(("rhs", "x", "r", "p", "q", "diagonal", "partial"), ti.types.ndarray()),
)
"""Of all nodes: number among the filled ones or -1, and psi. Of the filled ones: the node, its six
neighbours among them, the face weights, a; and the linear system."""


class Projection:
    """Arrays and parameters of the pressure solve.

    Args:
        grid: The grid.
        full: Mass of a node deep inside at the density of the source.
        gain: Share of an error of mass that is mended in a time step.
        tolerance: Largest residual over the largest right-hand side.
        iterations: Most iterations of conjugate gradients.
    """

    def __init__(
        self, grid: Grid, *, full: float, gain: float, tolerance: float = 5e-3,
        iterations: int = 400,
    ) -> None:  # fmt: skip
        device = backend.active()
        self.grid = grid
        self.full = full
        self.gain = gain
        self.tolerance = tolerance
        self.iterations = iterations
        self.iterations_made: int = 0
        n = grid.node_count
        self._chunks = CPU_CHUNK_COUNT if device.on_cpu else GPU_CHUNK_COUNT
        self._stride = CPU_CHUNK_STRIDE if device.on_cpu else 1
        self._count = device.integers(1)
        names = ("rhs", "x", "r", "p", "q", "diagonal")
        self._arrays: Any = Arrays(
            index=device.integers(n),
            node=device.integers(n),
            neighbors=device.integer_vectors(n, 6),
            weights=device.vectors(n, 6),
            filled=device.scalars(n),
            potential=device.scalars(n),
            partial=device.vectors(self._chunks, 4),
            **{name: device.scalars(n) for name in names},
        )

    def forget(self) -> None:
        """Start from psi = 0, as a resumed run does."""
        self._arrays.potential.fill(0)

    def project(self, nodes: Any, wanted: Any, wanted_next: Any, dt: float) -> None:
        """Change node velocities in place.

        Args:
            nodes: Velocity and mass, shape [r^3, 4]; zero where no particle reaches.
            wanted: m* at the nodes, shape [r^3], over `full`.
            wanted_next: m*' likewise.
            dt: Time step [s].
        """
        a, grid = self._arrays, self.grid
        collect(nodes, wanted, wanted_next, a, self._count, self.full, grid)
        count = int(self._count[0])
        size = -(-count // self._chunks)
        assemble(nodes, wanted, wanted_next, a, count, self.full, self.gain, dt, grid)
        begin(a, count, self._chunks, size, self._stride)
        limit = self.tolerance * max(self._largest(), 1e-12)
        self.iterations_made = 0
        while self.iterations_made < self.iterations:
            iterate(a, count, self._chunks, size, self._stride)
            self.iterations_made += BATCH
            if self._largest() < limit:
                break
        finish(nodes, a, count, grid)
        calm(nodes, NEARLY_EMPTY * self.full, CALM * grid.dx / dt)

    def _largest(self) -> float:
        return float(self._arrays.partial.to_numpy()[:, 3].max())


@ti.kernel
def collect(
    nodes: ti.types.ndarray(),
    wanted: ti.types.ndarray(),
    wanted_next: ti.types.ndarray(),
    arrays: Arrays,
    count: ti.types.ndarray(),
    full: float,
    grid: ti.template(),
):
    """List the nodes that take part, in their order: serial."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        found = 0
        for i in range(grid.node_count):
            share = ti.max(wanted[i], wanted_next[i])
            arrays.index[i] = -1
            if share > LEAST_FILLED:
                if is_inside(i, grid):
                    arrays.index[i] = found
                    arrays.node[found] = i
                    arrays.filled[found] = ti.min(ti.max(share, nodes[i].w / full), 1.0)
                    found += 1
        count[0] = found


@ti.kernel
def assemble(
    nodes: ti.types.ndarray(),
    wanted: ti.types.ndarray(),
    wanted_next: ti.types.ndarray(),
    arrays: Arrays,
    count: int,
    full: float,
    gain: float,
    dt: float,
    grid: ti.template(),
):
    """The linear system, and its solution of the step before."""
    for k in range(count):
        i = arrays.node[k]
        change = wanted_next[i] - wanted[i] + gain * (wanted[i] - nodes[i].w / full)
        source, total = change * grid.dx**2 / dt, 1e-6
        for f in ti.static(range(6)):
            axis, sign = ti.static(f // 2, 1 - 2 * (f % 2))
            step = ti.static(sign * grid.resolution ** (2 - axis))
            other = arrays.index[i + step]
            weight = 0.0
            if other >= 0:
                weight = 0.5 * (arrays.filled[k] + arrays.filled[other])
                flow = 0.5 * (nodes[i][axis] + nodes[i + step][axis])
                source += sign * weight * flow * grid.dx
            else:
                other = k
            arrays.neighbors[k][f] = other
            arrays.weights[k][f] = weight
            total += weight
        arrays.rhs[k] = source
        arrays.diagonal[k] = total
        arrays.x[k] = arrays.potential[i]


@ti.func
def applied(vector: ti.template(), arrays: ti.template(), k: int):
    """Row k of the matrix times a vector."""
    total = arrays.diagonal[k] * vector[k]
    for f in ti.static(range(6)):
        total -= arrays.weights[k][f] * vector[arrays.neighbors[k][f]]
    return total


@ti.func
def chunk_sum(arrays: ti.template(), chunks: int, column: ti.template()):
    """Sum a column of the chunks' partial results in their order."""
    total = 0.0
    for c in range(chunks):
        total += arrays.partial[c][column]
    return total


@ti.kernel
def begin(arrays: Arrays, count: int, chunks: int, size: int, stride: int):
    """Residual and first direction; partial holds (p.q, r.z, r.z before, max |rhs|)."""
    for task in range(chunks * stride):
        if task % stride == 0:
            chunk = task // stride
            rz, largest = 0.0, 0.0
            for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                residual = arrays.rhs[k] - applied(arrays.x, arrays, k)
                arrays.r[k] = residual
                arrays.p[k] = residual / arrays.diagonal[k]
                rz += residual**2 / arrays.diagonal[k]
                largest = ti.max(largest, ti.abs(arrays.rhs[k]))
            arrays.partial[chunk] = ti.Vector([0.0, rz, rz, largest])


@ti.kernel
def iterate(arrays: Arrays, count: int, chunks: int, size: int, stride: int):
    """Some iterations of conjugate gradients, preconditioned by the diagonal."""
    for _ in ti.static(range(BATCH)):
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                pq = 0.0
                for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                    image = applied(arrays.p, arrays, k)
                    arrays.q[k] = image
                    pq += arrays.p[k] * image
                arrays.partial[chunk][0] = pq
                arrays.partial[chunk][2] = arrays.partial[chunk][1]
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                alpha = chunk_sum(arrays, chunks, 2) / ti.max(chunk_sum(arrays, chunks, 0), 1e-30)
                rz, largest = 0.0, 0.0
                for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                    arrays.x[k] += alpha * arrays.p[k]
                    residual = arrays.r[k] - alpha * arrays.q[k]
                    arrays.r[k] = residual
                    rz += residual**2 / arrays.diagonal[k]
                    largest = ti.max(largest, ti.abs(residual))
                arrays.partial[chunk][1] = rz
                arrays.partial[chunk][3] = largest
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                beta = chunk_sum(arrays, chunks, 1) / ti.max(chunk_sum(arrays, chunks, 2), 1e-30)
                for k in range(chunk * size, ti.min((chunk + 1) * size, count)):
                    arrays.p[k] = arrays.r[k] / arrays.diagonal[k] + beta * arrays.p[k]


@ti.kernel
def finish(nodes: ti.types.ndarray(), arrays: Arrays, count: int, grid: ti.template()):
    """Add grad psi to the velocities: the mean over the faces, by how far they are filled."""
    for k in range(count):
        i = arrays.node[k]
        arrays.potential[i] = arrays.x[k]
        for axis in ti.static(range(3)):
            ahead, behind = arrays.weights[k][2 * axis], arrays.weights[k][2 * axis + 1]
            rise = ahead * (arrays.x[arrays.neighbors[k][2 * axis]] - arrays.x[k])
            rise += behind * (arrays.x[k] - arrays.x[arrays.neighbors[k][2 * axis + 1]])
            nodes[i][axis] += rise / (grid.dx * ti.max(ahead + behind, 1e-12))


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
