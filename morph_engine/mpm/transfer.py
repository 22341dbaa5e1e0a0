"""Particle-grid transfers of one MLS-MPM step, each with its adjoint directly below it.

A node value is the vector (momentum or velocity, mass). Scattering kernels add to private grids,
one per chunk of particles, which `gather_chunks` sums in a fixed order; on a GPU there is one grid
and the additions are atomic. Stencil loops are unrolled (`ti.static`), with sums along a grid row
taken first, so that the compiler sees straight-line arithmetic.
"""

import taichi as ti

from morph_engine.backend import CPU_CHUNK_STRIDE
from morph_engine.mpm import kernel
from morph_engine.mpm.constitutive import rotation, stress, stress_differential, FIXED_COROTATED

# Bits of a step's fault flags (algorithm 12.2 C).
NON_FINITE, OUTSIDE, INVERTED, TOO_FAST = 1, 2, 4, 8
SMALLEST_MASS = 1e-12


@ti.func
def zero4():
    """A zero node value; built in a kernel, so that it has the precision Taichi runs in."""
    return ti.Vector.zero(float, 4)


@ti.func
def chunk_bounds(chunk: int, chunk_size: int, count: int):
    """First and one-past-last item of a chunk."""
    return ti.min(chunk * chunk_size, count), ti.min((chunk + 1) * chunk_size, count)


@ti.func
def claim_planes(
    chunk: int,
    first: int,
    last: int,
    x: ti.template(),
    planes: ti.template(),
    partial: ti.template(),
    geometry: ti.template(),
):
    """Clear the x planes of a chunk's private grid that its points reach; returns its offset."""
    nodes, width = ti.static(geometry.nodes, geometry.width)
    low, high = nodes, -1
    for p in range(first, last):
        base, _ = kernel.base_and_offset(x[p], geometry)
        low = ti.min(low, base.x)
        high = ti.max(high, base.x + width - 1)
    planes[chunk] = ti.Vector([low, high])
    offset = chunk * nodes**3
    for i in range(offset + low * nodes**2, offset + (high + 1) * nodes**2):
        partial[i] = ti.zero(partial[i])
    return offset


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
    dx, nodes, width = ti.static(geometry.dx, geometry.nodes, geometry.width)
    base, u = kernel.base_and_offset(position, geometry)
    wx, wy, wz = kernel.weights(u.x, width), kernel.weights(u.y, width), kernel.weights(u.z, width)
    corner = offset + kernel.flat_index(base, geometry)
    for i in ti.static(range(width)):
        at_i = constant + linear[:, 0] * ((i - u.x) * dx)
        for j in ti.static(range(width)):
            at_j = at_i + linear[:, 1] * ((j - u.y) * dx)
            w_ij = wx[i] * wy[j]
            row = corner + (i * nodes + j) * nodes
            for k in ti.static(range(width)):
                w = w_ij * wz[k]
                value = w * (at_j + linear[:, 2] * ((k - u.z) * dx))
                share = ti.Vector([value.x, value.y, value.z, w * mass])
                if ti.static(atomic):
                    ti.atomic_add(partial[row + k], share)
                else:
                    partial[row + k] = partial[row + k] + share


@ti.func
def gather_chunks(
    i: int,
    planes: ti.template(),
    partial: ti.template(),
    chunk_count: int,
    geometry: ti.template(),
    atomic: ti.template(),
):
    """Sum node i over the private grids that hold its plane, in the order of the chunks."""
    total = partial[i]
    if ti.static(not atomic):
        total = ti.zero(total)
        plane = i // ti.static(geometry.nodes**2)
        for c in range(chunk_count):
            if planes[c][0] <= plane and plane <= planes[c][1]:
                total += partial[c * geometry.node_count + i]
    return total


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
    planes: ti.types.ndarray(),
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
    affine, dx, nodes, width = ti.static(
        geometry.affine, geometry.dx, geometry.nodes, geometry.width
    )
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
                offset = claim_planes(
                    chunk, first, last, x, planes, partial, geometry
                )
            for p in range(first, last):
                A = F[p] + U[p]
                if ti.static(model == FIXED_COROTATED):
                    R[p] = rotation(A)
                P = stress(A, R[p], lame_lambda, lame_mu, model)
                B = -affine * dt * volume[p] * (P @ A.transpose()) + mass * C[p]
                momentum = (1 - dt * drag) * mass * v[p]
                scatter(
                    partial, offset, x[p], momentum, B, mass, geometry, atomic
                )
    for i in range(geometry.node_count):
        node = gather_chunks(i, planes, partial, chunk_count, geometry, atomic)
        m = node.w
        if m > SMALLEST_MASS and kernel.is_inside(i, geometry):
            grid[i] = ti.Vector([node.x / m, node.y / m, node.z / m, m])
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
    planes: ti.types.ndarray(),
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
    """Adjoint of the grid step: node values (Pi_bar, M_bar) from the particles (algorithm 4.1, 4.2).

    `smoothing_factor` is (1 - s) in the exact adjoint, 1 in the published one.
    """
    affine, dx, nodes, width = ti.static(
        geometry.affine, geometry.dx, geometry.nodes, geometry.width
    )
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
                offset = claim_planes(
                    chunk, first, last, x, planes, partial, geometry
                )
            for p in range(first, last):
                nu = v_bar[p] + dt * x_bar[p]
                A = F[p] + U[p]
                Gamma = C_bar[p] + (smoothing_factor * dt) * (F_bar[p] @ A.transpose())
                scatter(
                    partial, offset, x[p], nu, affine * Gamma, 0.0, geometry,
                    atomic,
                )
    for i in range(geometry.node_count):
        v_node = grid[i]
        if v_node.w > SMALLEST_MASS:
            node = gather_chunks(i, planes, partial, chunk_count, geometry, atomic)
            Pi_bar = node.xyz / v_node.w
            M_bar = -v_node.xyz.dot(Pi_bar)
            grid_bar[i] = ti.Vector([Pi_bar.x, Pi_bar.y, Pi_bar.z, M_bar])
        else:
            grid_bar[i] = zero4()


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
    affine, dx, nodes, width = ti.static(
        geometry.affine, geometry.dx, geometry.nodes, geometry.width
    )
    for p in range(count):
        base, u = kernel.base_and_offset(x[p], geometry)
        wx = kernel.weights(u.x, width)
        wy = kernel.weights(u.y, width)
        wz = kernel.weights(u.z, width)
        corner = kernel.flat_index(base, geometry)
        velocity = zero4()
        by_x, by_y, by_z = zero4(), zero4(), zero4()
        for i in ti.static(range(width)):
            plane, plane_y, plane_z = zero4(), zero4(), zero4()
            for j in ti.static(range(width)):
                row = corner + (i * nodes + j) * nodes
                line, line_z = zero4(), zero4()
                for k in ti.static(range(width)):
                    weighted = wz[k] * grid[row + k]
                    line += weighted
                    if ti.static(k > 0):
                        line_z += k * weighted
                plane += wy[j] * line
                plane_y += (wy[j] * (j - u.y)) * line
                plane_z += wy[j] * line_z
            velocity += wx[i] * plane
            by_x += (wx[i] * (i - u.x)) * plane
            by_y += wx[i] * plane_y
            by_z += wx[i] * plane_z
        by_z -= u.z * velocity
        C = (affine * dx) * ti.Matrix.cols([by_x.xyz, by_y.xyz, by_z.xyz])
        v = velocity.xyz
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
    grid: ti.types.ndarray(),
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
    affine, dx, nodes, width = ti.static(
        geometry.affine, geometry.dx, geometry.nodes, geometry.width
    )
    for p in range(count):
        base, u = kernel.base_and_offset(x[p], geometry)
        wy = kernel.weights(u.y, width)
        wz = kernel.weights(u.z, width)
        gy = kernel.slopes(u.y, width)
        gz = kernel.slopes(u.z, width)
        corner = kernel.flat_index(base, geometry)

        A = F[p] + U[p]
        P = stress(A, R[p], lame_lambda, lame_mu, model)
        B = -affine * dt * volume[p] * (P @ A.transpose()) + mass * C[p]
        F_bar_next = F_bar[p]
        nu = v_bar[p] + dt * x_bar[p]
        Gamma = C_bar[p] + (smoothing_factor * dt) * (F_bar_next @ A.transpose())
        momentum = (1 - weight_drag * dt * drag) * mass * v[p]

        # q = sum w Pi_bar, Q = sum w Pi_bar (x) d, e = sum grad w (scalar of the node)
        q = zero4()
        q_x, q_y, q_z = zero4(), zero4(), zero4()
        e = ti.Vector.zero(float, 3)
        from_pi = ti.Matrix.cols([momentum, B[:, 0] * dx, B[:, 1] * dx, B[:, 2] * dx])
        from_v = ti.Matrix.cols(
            [nu, Gamma[:, 0] * (affine * dx), Gamma[:, 1] * (affine * dx),
             Gamma[:, 2] * (affine * dx)]
        )
        for i in range(width):
            wx_i, gx_i = kernel.weight_and_slope(i - u.x, width)
            plane, plane_y, plane_z = zero4(), zero4(), zero4()
            s_plane, s_y, s_z = 0.0, 0.0, 0.0
            pi_i = from_pi[:, 0] + from_pi[:, 1] * (i - u.x)
            v_i = from_v[:, 0] + from_v[:, 1] * (i - u.x)
            for j in ti.static(range(width)):
                row = corner + (i * nodes + j) * nodes
                line, line_z = zero4(), zero4()
                s_line, s_slope = 0.0, 0.0
                pi_j = pi_i + from_pi[:, 2] * (j - u.y)
                v_j = v_i + from_v[:, 2] * (j - u.y)
                for k in ti.static(range(width)):
                    bar = grid_bar[row + k]
                    node = grid[row + k]
                    scalar = (
                        mass * bar.w
                        + bar.xyz.dot(pi_j + from_pi[:, 3] * (k - u.z))
                        + node.xyz.dot(v_j + from_v[:, 3] * (k - u.z))
                    )
                    weighted = wz[k] * bar
                    line += weighted
                    if ti.static(k > 0):
                        line_z += k * weighted
                    s_line += wz[k] * scalar
                    s_slope += gz[k] * scalar
                plane += wy[j] * line
                plane_y += (wy[j] * (j - u.y)) * line
                plane_z += wy[j] * line_z
                s_plane += wy[j] * s_line
                s_y += gy[j] * s_line
                s_z += wy[j] * s_slope
            q += wx_i * plane
            q_x += (wx_i * (i - u.x)) * plane
            q_y += wx_i * plane_y
            q_z += wx_i * plane_z
            e += ti.Vector([gx_i * s_plane, wx_i * s_y, wx_i * s_z])
        q_z -= u.z * q
        Q = dx * ti.Matrix.cols([q_x.xyz, q_y.xyz, q_z.xyz])
        e /= dx

        P_bar = (-affine * dt * volume[p]) * (Q @ A)
        C_new = C_next[p]
        A_bar = (
            (-affine * dt * volume[p]) * (Q.transpose() @ P)
            + stress_differential(A, R[p], P_bar, lame_lambda, lame_mu, model)
            + (1 - smoothing) * (F_bar_next + dt * (C_new.transpose() @ F_bar_next))
        )
        x_bar[p] = decay * (
            x_bar[p]
            + e
            - B.transpose() @ q.xyz
            - affine * (Gamma.transpose() @ v_next[p])
        )
        v_bar[p] = decay * (1 - dt * drag) * mass * q.xyz
        C_bar[p] = decay * mass * Q
        U_bar[p] = decay * (A_bar + control_carry * smoothing * F_bar_next)
        F_bar[p] = decay * (A_bar + smoothing * F_bar_next)
