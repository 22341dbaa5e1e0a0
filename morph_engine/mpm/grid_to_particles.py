"""Grid to particles (G2P): velocity and the particles' update; the adjoint directly below."""

from typing import Any

import taichi as ti

from morph_engine.mpm import b_spline, stencil
from morph_engine.mpm.constitutive import kirchhoff_stress, kirchhoff_stress_adjoint
from morph_engine.mpm.faults import INVERTED, NON_FINITE, OUTSIDE, TOO_FAST
from morph_engine.mpm.grid import base_and_offset, flat_index, presence, row_index
from morph_engine.mpm.particles_to_grid import join

# Only what the kernel works on: see `ParticlesToGridArrays`.
GridToParticlesArrays: Any = ti.types.argpack(
    **dict.fromkeys(("x", "F", "U", "nodes"), ti.types.ndarray()),
    **dict.fromkeys(("x_next", "v_next", "C_next", "F_next"), ti.types.ndarray()),
)
GridToParticlesAdjointArrays: Any = ti.types.argpack(
    **dict.fromkeys(("x", "v", "C", "F", "U", "R", "volume"), ti.types.ndarray()),
    **dict.fromkeys(("v_next", "C_next", "nodes_bar"), ti.types.ndarray()),
    **dict.fromkeys(("x_bar", "v_bar", "C_bar", "F_bar", "U_bar"), ti.types.ndarray()),
)


@ti.kernel
def grid_to_particles(
    step: GridToParticlesArrays,
    faults: ti.types.ndarray(),
    dt: float,
    smoothing: float,
    domain: float,
    largest_speed: float,
    grid: ti.template(),
):
    """Grid velocity to the particles, and their update (algorithm 2.5).

    Sets bits in `faults[0]` when a particle is non-finite, outside [-domain, domain]^3, inverted or
    faster than `largest_speed`.
    """
    affine, dx, width = ti.static(grid.affine, grid.dx, grid.width)
    for p in range(step.x.shape[0]):
        base, u = base_and_offset(step.x[p], grid)
        wx, wy = b_spline.weights(u.x, width), b_spline.weights(u.y, width)
        wz = b_spline.weights(u.z, width) * presence(step.x[p], grid)
        corner = flat_index(base, grid)
        # Sums over x and y of w v, w v dx and w v dy, for each z separately.
        memory = stencil.in_memory(u)
        flow = stencil.zero_sums(4 * width)
        flow_x, flow_y = stencil.zero_sums(4 * width), stencil.zero_sums(4 * width)
        for i in range(width):
            plane, plane_y = stencil.plane_moments(step.nodes, corner, i, wy, grid)
            stencil.accumulate(flow, memory, wx[i], plane)
            stencil.accumulate(flow_x, memory, wx[i] * (i - u.x), plane)
            stencil.accumulate(flow_y, memory, wx[i], plane_y)
        v_new, by_x = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        by_y, by_z = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        for k in ti.static(range(width)):
            for c in ti.static(range(3)):
                weighted = wz[k] * flow[memory, 4 * k + c]
                v_new[c] += weighted
                by_x[c] += wz[k] * flow_x[memory, 4 * k + c]
                by_y[c] += wz[k] * flow_y[memory, 4 * k + c]
                by_z[c] += (k - 1) * weighted
        by_y -= (u.y - 1) * v_new
        by_z -= (u.z - 1) * v_new
        C_new = (affine * dx) * ti.Matrix.cols([by_x, by_y, by_z])
        position = step.x[p] + dt * v_new
        F_old = step.F[p]
        A = F_old + step.U[p]
        F_new = (1 - smoothing) * (A + dt * (C_new @ A)) + smoothing * F_old
        step.x_next[p] = position
        step.v_next[p] = v_new
        step.C_next[p] = C_new
        step.F_next[p] = F_new
        fault = 0
        reach = ti.abs(position).max()
        det = ti.min(F_new.determinant(), A.determinant())
        # Written so that NaN, for which every comparison is false, counts as a fault.
        if not (reach + v_new.norm_sqr() + ti.abs(det) < 1e30):
            fault = NON_FINITE
        else:
            if reach > domain:
                fault |= OUTSIDE
            if det <= 0:
                fault |= INVERTED
            if v_new.norm_sqr() > largest_speed * largest_speed:
                fault |= TOO_FAST
        if fault != 0:
            ti.atomic_or(faults[0], fault)


@ti.kernel
def grid_to_particles_adjoint(
    step: GridToParticlesAdjointArrays,
    mass: float,
    lame_lambda: float,
    lame_mu: float,
    dt: float,
    drag: float,
    smoothing: float,
    smoothing_factor: float,
    decay: float,
    grid: ti.template(),
    scheme: ti.template(),
):
    """Adjoint of one particle's step, in place: layer k+1 becomes layer k (algorithm 4.3, 4.4).

    `smoothing_factor` is (1 - s) in the exact adjoint, 1 in the published one; `decay` multiplies
    the whole adjoint state afterwards.
    """
    affine, dx, width = ti.static(grid.affine, grid.dx, grid.width)
    for p in range(step.x.shape[0]):
        A = step.F[p] + step.U[p]
        T = kirchhoff_stress(A, step.R[p], lame_lambda, lame_mu, scheme.model)
        B = (-affine * dt * step.volume[p]) * T + mass * step.C[p]
        F_bar_next = step.F_bar[p]
        nu = step.v_bar[p] + dt * step.x_bar[p]
        Gamma = step.C_bar[p] + (smoothing_factor * dt) * (F_bar_next @ A.transpose())
        momentum = mass * step.v[p]
        if ti.static(not scheme.adjoint.drop_drag):
            momentum = (1 - dt * drag) * mass * step.v[p]

        base, u = base_and_offset(step.x[p], grid)
        wx, gx = b_spline.weights(u.x, width), b_spline.weight_derivatives(u.x, width)
        wy, gy = b_spline.weights(u.y, width), b_spline.weight_derivatives(u.y, width)
        wz, gz = b_spline.weights(u.z, width), b_spline.weight_derivatives(u.z, width)
        present = presence(step.x[p], grid)
        wz, gz = wz * present, gz * present
        corner = flat_index(base, grid)
        # The scalar of 4.3 at a node is the dot product of its nodes_bar with an affine function.
        by_x = join(B[:, 0] * dx, 0.0, Gamma[:, 0] * (affine * dx))
        by_y = join(B[:, 1] * dx, 0.0, Gamma[:, 1] * (affine * dx))
        by_z = join(B[:, 2] * dx, 0.0, Gamma[:, 2] * (affine * dx))
        center = join(momentum, mass, nu) - (u.z - 1) * by_z

        # q = sum w Pi_bar, Q = sum w Pi_bar (x) d, e = sum grad w (scalar of the node)
        memory = stencil.in_memory(u)
        sum_q, sum_x, sum_y, sum_z = [stencil.zero_sums(8) for _ in range(4)]
        e_x, e_y, e_z = [stencil.zero_sums(8) for _ in range(3)]
        for i in range(width):
            for j in range(width):
                first = row_index(corner, i, j, grid)
                line, line_z = stencil.row_moments(step.nodes_bar, first, wz, width)
                slope, slope_z = stencil.row_moments(step.nodes_bar, first, gz, width)
                affine_ij = center + by_x * (i - u.x) + by_y * (j - u.y)
                scalar = line * affine_ij + line_z * by_z
                w = wx[i] * wy[j]
                stencil.accumulate(sum_q, memory, w, line)
                stencil.accumulate(sum_x, memory, w * (i - u.x), line)
                stencil.accumulate(sum_y, memory, w * (j - u.y), line)
                stencil.accumulate(sum_z, memory, w, line_z)
                stencil.accumulate(e_x, memory, gx[i] * wy[j], scalar)
                stencil.accumulate(e_y, memory, wx[i] * gy[j], scalar)
                stencil.accumulate(e_z, memory, w, slope * affine_ij + slope_z * by_z)
        q = stencil.vector(sum_q, memory)
        Q_x, Q_y = stencil.vector(sum_x, memory), stencil.vector(sum_y, memory)
        Q_z = stencil.vector(sum_z, memory) - (u.z - 1) * q
        Q = dx * ti.Matrix.cols([Q_x, Q_y, Q_z])
        e = ti.Vector(
            [stencil.total(e_x, memory), stencil.total(e_y, memory), stencil.total(e_z, memory)]
        )

        T_bar = (-affine * dt * step.volume[p]) * Q
        C_new = step.C_next[p]
        A_bar = kirchhoff_stress_adjoint(A, step.R[p], T_bar, lame_lambda, lame_mu, scheme.model)
        A_bar += (1 - smoothing) * (F_bar_next + dt * (C_new.transpose() @ F_bar_next))
        step.x_bar[p] = decay * (
            step.x_bar[p]
            + e / dx
            - B.transpose() @ q
            - affine * (Gamma.transpose() @ step.v_next[p])
        )
        step.v_bar[p] = decay * (1 - dt * drag) * mass * q
        step.C_bar[p] = decay * mass * Q
        control_bar = A_bar
        if ti.static(scheme.adjoint.carry_control):
            control_bar += smoothing * F_bar_next
        step.U_bar[p] = decay * control_bar
        step.F_bar[p] = decay * (A_bar + smoothing * F_bar_next)
