"""Particle-grid transfers of one MLS-MPM step, each with its adjoint directly below it.

A node value is the vector (momentum or velocity, mass). Scattering kernels add to private grids,
one per chunk of particles, which `gather_chunks` sums in a fixed order; on a GPU there is one grid
and the additions are atomic. Stencils are worked off row by row along z, where nodes lie side by
side, so that the compiler finds vector instructions.
"""

import taichi as ti

from morph_engine.backend import CPU_CHUNK_STRIDE
from morph_engine.mpm import kernel
from morph_engine.mpm.constitutive import (
    FIXED_COROTATED,
    kirchhoff_stress,
    kirchhoff_stress_adjoint,
    rotation,
)

# Bits of a step's fault flags (algorithm 12.2 C).
NON_FINITE, OUTSIDE, INVERTED, TOO_FAST = 1, 2, 4, 8
SMALLEST_MASS = 1e-12


@ti.func
def zero4():
    """A zero node value; built in a kernel, so that it has the precision Taichi runs in."""
    return ti.Vector.zero(float, 4)


@ti.func
def append(a, b: float):
    """(a, b): a vector and a number as one vector of four."""
    return ti.Vector([a.x, a.y, a.z, b])


@ti.func
def join(a, b: float, c):
    """(a, b, c, 0): two vectors and a number as one vector of eight."""
    return ti.Vector([a.x, a.y, a.z, b, c.x, c.y, c.z, 0.0])


@ti.func
def chunk_bounds(chunk: int, chunk_size: int, count: int):
    """First and one-past-last item of a chunk."""
    return ti.min(chunk * chunk_size, count), ti.min((chunk + 1) * chunk_size, count)


@ti.func
def claim_rows(
    chunk: int,
    first: int,
    last: int,
    x: ti.template(),
    claims: ti.template(),
    partial: ti.template(),
    geometry: ti.template(),
):
    """Clear the rows of a chunk's private grid that its points reach; returns its offset."""
    nodes, width = ti.static(geometry.nodes, geometry.width)
    low, high = ti.Vector([nodes, nodes]), ti.Vector([-1, -1])
    for p in range(first, last):
        base, _ = kernel.base_and_offset(x[p], geometry)
        low = ti.min(low, base.xy)
        high = ti.max(high, base.xy + width - 1)
    claims[chunk] = ti.Vector([low.x, high.x, low.y, high.y])
    offset = chunk * nodes**3
    for i in range(low.x, high.x + 1):
        plane = offset + i * nodes**2
        for node in range(plane + low.y * nodes, plane + (high.y + 1) * nodes):
            partial[node] = ti.zero(partial[node])
    return offset


@ti.func
def claimants(
    row: int,
    claims: ti.template(),
    chunk_count: int,
    geometry: ti.template(),
    atomic: ti.template(),
):
    """The chunks that claimed a row of nodes along z, as bits; 0 where no particle reaches."""
    chunks = 1
    if ti.static(not atomic):
        x, y = row // geometry.nodes, row % geometry.nodes
        chunks = 0
        for chunk in range(chunk_count):
            claim = claims[chunk]
            if claim[0] <= x and x <= claim[1] and claim[2] <= y and y <= claim[3]:
                chunks |= 1 << chunk
    return chunks


@ti.func
def scatter(
    partial: ti.template(),
    offset: int,
    position,
    constant,
    linear,
    mass: float,
    geometry: ti.template(),
    atomic: ti.template(),
):
    """Add w_ip (constant + linear d_ip, mass) to the nodes around one particle."""
    dx, width = ti.static(geometry.dx, geometry.width)
    base, u = kernel.base_and_offset(position, geometry)
    wx, wy, wz = kernel.weights(u.x, width), kernel.weights(u.y, width), kernel.weights(u.z, width)
    corner = offset + kernel.flat_index(base, geometry)
    by_x, by_y = append(linear[:, 0] * dx, 0.0), append(linear[:, 1] * dx, 0.0)
    by_z, center = append(linear[:, 2] * dx, 0.0), append(constant, mass)
    along_z = kernel.make_row(wz, center, by_z, u.z, width)
    for i in range(width):
        for j in range(width):
            w = wx[i] * wy[j]
            across = w * (by_x * (i - u.x) + by_y * (j - u.y))
            share = w * along_z + ti.Vector(
                [wz[k] * across[c] for k in range(width) for c in range(4)]
            )
            kernel.add_row(partial, kernel.row(corner, i, j, geometry), share, width, atomic)


@ti.func
def gather_chunks(
    i: int,
    chunks: int,
    partial: ti.template(),
    chunk_count: int,
    geometry: ti.template(),
    atomic: ti.template(),
):
    """Sum node i over the private grids of the chunks given as bits, in their order."""
    total = partial[i]
    if ti.static(not atomic):
        total = ti.zero(total)
        for chunk in range(chunk_count):
            if chunks >> chunk & 1:
                total += partial[chunk * geometry.node_count + i]
    return total


@ti.kernel
def clear(
    x: ti.types.ndarray(), v: ti.types.ndarray(), C: ti.types.ndarray(), F: ti.types.ndarray()
):
    """Set a particle state to zero."""
    for p in range(x.shape[0]):
        x[p], v[p] = ti.zero(x[p]), ti.zero(v[p])
        C[p], F[p] = ti.zero(C[p]), ti.zero(F[p])


@ti.kernel
def particles_to_grid(
    x: ti.types.ndarray(),
    v: ti.types.ndarray(),
    C: ti.types.ndarray(),
    F: ti.types.ndarray(),
    U: ti.types.ndarray(),
    R: ti.types.ndarray(),
    volume: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    claims: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    count: int,
    mass: float,
    lame_lambda: float,
    lame_mu: float,
    dt: float,
    drag: float,
    chunk_count: int,
    chunk_size: int,
    geometry: ti.template(),
    model: ti.template(),
    atomic: ti.template(),
):
    """Momentum and mass of the particles to grid velocity and mass (algorithm 2.3, 2.4).

    Leaves (velocity, mass) in `grid` and, for the corotated law, the rotations in `R`.
    """
    affine = ti.static(geometry.affine)
    if ti.static(atomic):
        for i in range(geometry.node_count):
            partial[i] = zero4()
    stride = ti.static(1 if atomic else CPU_CHUNK_STRIDE)
    for task in range(chunk_count * stride):
        if task % stride == 0:
            chunk = task // stride
            first, last = chunk_bounds(chunk, chunk_size, count)
            offset = 0
            if ti.static(not atomic):
                offset = claim_rows(chunk, first, last, x, claims, partial, geometry)
            for p in range(first, last):
                A = F[p] + U[p]
                if ti.static(model == FIXED_COROTATED):
                    R[p] = rotation(A)
                T = kirchhoff_stress(A, R[p], lame_lambda, lame_mu, model)
                B = (-affine * dt * volume[p]) * T + mass * C[p]
                momentum = (1 - dt * drag) * mass * v[p]
                scatter(partial, offset, x[p], momentum, B, mass, geometry, atomic)
    for row in range(geometry.nodes**2):
        chunks = claimants(row, claims, chunk_count, geometry, atomic)
        if chunks != 0:  # no other row is ever read
            for i in range(row * geometry.nodes, (row + 1) * geometry.nodes):
                node = gather_chunks(i, chunks, partial, chunk_count, geometry, atomic)
                m = node.w
                if m > SMALLEST_MASS and kernel.is_inside(i, geometry):
                    grid[i] = append(node.xyz / m, m)
                else:
                    grid[i] = zero4()


@ti.kernel
def particles_to_grid_adjoint(
    x: ti.types.ndarray(),
    F: ti.types.ndarray(),
    U: ti.types.ndarray(),
    x_bar: ti.types.ndarray(),
    v_bar: ti.types.ndarray(),
    C_bar: ti.types.ndarray(),
    F_bar: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    claims: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    grid_bar: ti.types.ndarray(),
    count: int,
    smoothing_factor: float,
    dt: float,
    chunk_count: int,
    chunk_size: int,
    geometry: ti.template(),
    atomic: ti.template(),
):
    """Adjoint of the grid step: Pi_bar and M_bar from the particles (algorithm 4.1, 4.2).

    `grid_bar` receives (Pi_bar, M_bar, v, 0), what `grid_to_particles_adjoint` reads of a node.
    `smoothing_factor` is (1 - s) in the exact adjoint, 1 in the published one.
    """
    affine = ti.static(geometry.affine)
    if ti.static(atomic):
        for i in range(geometry.node_count):
            partial[i] = zero4()
    stride = ti.static(1 if atomic else CPU_CHUNK_STRIDE)
    for task in range(chunk_count * stride):
        if task % stride == 0:
            chunk = task // stride
            first, last = chunk_bounds(chunk, chunk_size, count)
            offset = 0
            if ti.static(not atomic):
                offset = claim_rows(chunk, first, last, x, claims, partial, geometry)
            for p in range(first, last):
                nu = v_bar[p] + dt * x_bar[p]
                A = F[p] + U[p]
                Gamma = C_bar[p] + (smoothing_factor * dt) * (F_bar[p] @ A.transpose())
                scatter(partial, offset, x[p], nu, affine * Gamma, 0.0, geometry, atomic)
    for row in range(geometry.nodes**2):
        chunks = claimants(row, claims, chunk_count, geometry, atomic)
        if chunks != 0:  # no other row is ever read
            for i in range(row * geometry.nodes, (row + 1) * geometry.nodes):
                v_node = grid[i]
                if v_node.w > SMALLEST_MASS:
                    node = gather_chunks(i, chunks, partial, chunk_count, geometry, atomic)
                    Pi_bar = node.xyz / v_node.w
                    M_bar = -v_node.xyz.dot(Pi_bar)
                    grid_bar[i] = join(Pi_bar, M_bar, v_node.xyz)
                else:
                    grid_bar[i] = ti.Vector.zero(float, 8)


@ti.kernel
def grid_to_particles(
    x: ti.types.ndarray(),
    F: ti.types.ndarray(),
    U: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    x_next: ti.types.ndarray(),
    v_next: ti.types.ndarray(),
    C_next: ti.types.ndarray(),
    F_next: ti.types.ndarray(),
    faults: ti.types.ndarray(),
    count: int,
    dt: float,
    smoothing: float,
    domain: float,
    largest_speed: float,
    geometry: ti.template(),
):
    """Grid velocity to the particles, and their update (algorithm 2.5).

    Sets bits in `faults[0]` when a particle is non-finite, outside [-domain, domain]^3, inverted or
    faster than `largest_speed`.
    """
    affine, dx, width = ti.static(geometry.affine, geometry.dx, geometry.width)
    for p in range(count):
        base, u = kernel.base_and_offset(x[p], geometry)
        wx, wy = kernel.weights(u.x, width), kernel.weights(u.y, width)
        wz = kernel.weights(u.z, width)
        corner = kernel.flat_index(base, geometry)
        # Sums over x and y of w v, w v dx and w v dy, for each z separately.
        memory = kernel.in_memory(u)
        flow = kernel.zero_sums(4 * width)
        flow_x, flow_y = kernel.zero_sums(4 * width), kernel.zero_sums(4 * width)
        for i in range(width):
            plane, plane_y = kernel.plane_moments(grid, corner, i, wy, geometry)
            kernel.accumulate(flow, memory, wx[i], plane)
            kernel.accumulate(flow_x, memory, wx[i] * (i - u.x), plane)
            kernel.accumulate(flow_y, memory, wx[i], plane_y)
        v, by_x = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        by_y, by_z = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        for k in ti.static(range(width)):
            for c in ti.static(range(3)):
                weighted = wz[k] * flow[memory, 4 * k + c]
                v[c] += weighted
                by_x[c] += wz[k] * flow_x[memory, 4 * k + c]
                by_y[c] += wz[k] * flow_y[memory, 4 * k + c]
                by_z[c] += (k - 1) * weighted
        by_y -= (u.y - 1) * v
        by_z -= (u.z - 1) * v
        C = (affine * dx) * ti.Matrix.cols([by_x, by_y, by_z])
        position = x[p] + dt * v
        F_old = F[p]
        A = F_old + U[p]
        F_new = (1 - smoothing) * (A + dt * (C @ A)) + smoothing * F_old
        x_next[p] = position
        v_next[p] = v
        C_next[p] = C
        F_next[p] = F_new
        fault = 0
        reach = ti.abs(position).max()
        det = ti.min(F_new.determinant(), A.determinant())
        # Written so that NaN, for which every comparison is false, counts as a fault.
        if not (reach + v.norm_sqr() + ti.abs(det) < 1e30):
            fault = NON_FINITE
        else:
            if reach > domain:
                fault |= OUTSIDE
            if det <= 0:
                fault |= INVERTED
            if v.norm_sqr() > largest_speed * largest_speed:
                fault |= TOO_FAST
        if fault != 0:
            ti.atomic_or(faults[0], fault)


@ti.kernel
def grid_to_particles_adjoint(
    x: ti.types.ndarray(),
    v: ti.types.ndarray(),
    C: ti.types.ndarray(),
    F: ti.types.ndarray(),
    U: ti.types.ndarray(),
    R: ti.types.ndarray(),
    C_next: ti.types.ndarray(),
    v_next: ti.types.ndarray(),
    volume: ti.types.ndarray(),
    grid_bar: ti.types.ndarray(),
    x_bar: ti.types.ndarray(),
    v_bar: ti.types.ndarray(),
    C_bar: ti.types.ndarray(),
    F_bar: ti.types.ndarray(),
    U_bar: ti.types.ndarray(),
    count: int,
    mass: float,
    lame_lambda: float,
    lame_mu: float,
    dt: float,
    drag: float,
    smoothing: float,
    smoothing_factor: float,
    weight_drag: float,
    control_carry: float,
    decay: float,
    geometry: ti.template(),
    model: ti.template(),
):
    """Adjoint of one particle's step, in place: layer k+1 becomes layer k (algorithm 4.3, 4.4).

    The three departures of the published adjoint are numbers: `smoothing_factor` (1 for (1 - s)),
    `weight_drag` (0 leaves the drag out of the weight derivative), `control_carry` (1 adds s F_bar'
    to the control gradient). `decay` multiplies the whole adjoint state afterwards.
    """
    affine, dx, width = ti.static(geometry.affine, geometry.dx, geometry.width)
    for p in range(count):
        A = F[p] + U[p]
        T = kirchhoff_stress(A, R[p], lame_lambda, lame_mu, model)
        B = (-affine * dt * volume[p]) * T + mass * C[p]
        F_bar_next = F_bar[p]
        nu = v_bar[p] + dt * x_bar[p]
        Gamma = C_bar[p] + (smoothing_factor * dt) * (F_bar_next @ A.transpose())
        momentum = (1 - weight_drag * dt * drag) * mass * v[p]

        base, u = kernel.base_and_offset(x[p], geometry)
        wx, gx = kernel.weights(u.x, width), kernel.slopes(u.x, width)
        wy, gy = kernel.weights(u.y, width), kernel.slopes(u.y, width)
        wz, gz = kernel.weights(u.z, width), kernel.slopes(u.z, width)
        corner = kernel.flat_index(base, geometry)
        # The scalar of 4.3 at a node is the dot product of grid_bar with an affine function of it.
        by_x = join(B[:, 0] * dx, 0.0, Gamma[:, 0] * (affine * dx))
        by_y = join(B[:, 1] * dx, 0.0, Gamma[:, 1] * (affine * dx))
        by_z = join(B[:, 2] * dx, 0.0, Gamma[:, 2] * (affine * dx))
        center = join(momentum, mass, nu) - (u.z - 1) * by_z

        # q = sum w Pi_bar, Q = sum w Pi_bar (x) d, e = sum grad w (scalar of the node)
        memory = kernel.in_memory(u)
        sum_q, sum_x, sum_y, sum_z = [kernel.zero_sums(8) for _ in range(4)]
        e_x, e_y, e_z = [kernel.zero_sums(8) for _ in range(3)]
        for i in range(width):
            for j in range(width):
                first = kernel.row(corner, i, j, geometry)
                line, line_z = kernel.row_moments(grid_bar, first, wz, width)
                slope, slope_z = kernel.row_moments(grid_bar, first, gz, width)
                affine_ij = center + by_x * (i - u.x) + by_y * (j - u.y)
                scalar = line * affine_ij + line_z * by_z
                w = wx[i] * wy[j]
                kernel.accumulate(sum_q, memory, w, line)
                kernel.accumulate(sum_x, memory, w * (i - u.x), line)
                kernel.accumulate(sum_y, memory, w * (j - u.y), line)
                kernel.accumulate(sum_z, memory, w, line_z)
                kernel.accumulate(e_x, memory, gx[i] * wy[j], scalar)
                kernel.accumulate(e_y, memory, wx[i] * gy[j], scalar)
                kernel.accumulate(e_z, memory, w, slope * affine_ij + slope_z * by_z)
        q = kernel.vector(sum_q, memory)
        Q_x, Q_y = kernel.vector(sum_x, memory), kernel.vector(sum_y, memory)
        Q_z = kernel.vector(sum_z, memory) - (u.z - 1) * q
        Q = dx * ti.Matrix.cols([Q_x, Q_y, Q_z])
        e = ti.Vector(
            [kernel.total(e_x, memory), kernel.total(e_y, memory), kernel.total(e_z, memory)]
        )

        T_bar = (-affine * dt * volume[p]) * Q
        C_new = C_next[p]
        A_bar = kirchhoff_stress_adjoint(A, R[p], T_bar, lame_lambda, lame_mu, model)
        A_bar += (1 - smoothing) * (F_bar_next + dt * (C_new.transpose() @ F_bar_next))
        x_bar[p] = decay * (
            x_bar[p] + e / dx - B.transpose() @ q - affine * (Gamma.transpose() @ v_next[p])
        )
        v_bar[p] = decay * (1 - dt * drag) * mass * q
        C_bar[p] = decay * mass * Q
        U_bar[p] = decay * (A_bar + control_carry * smoothing * F_bar_next)
        F_bar[p] = decay * (A_bar + smoothing * F_bar_next)
