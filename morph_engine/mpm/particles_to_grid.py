"""Particles to grid (P2G): momentum and mass to the nodes, and the adjoint directly below.

A node value is the vector (momentum or velocity, mass).
"""

from typing import Any

import taichi as ti

from morph_engine.mpm import b_spline, stencil
from morph_engine.mpm.constitutive import FIXED_COROTATED, kirchhoff_stress, rotation
from morph_engine.mpm.grid import base_and_offset, flat_index, is_inside, presence, row_index
from morph_engine.mpm.private_grids import begin_chunk, sum_chunks, task_count, touching_chunks

SMALLEST_MASS = 1e-12

# Arrays of one time step, see `Layer`, `Transition`, `PrivateGrids`. A launch takes some 5 us for
# each, so that a kernel's pack has those that it works on and no others.
ParticlesToGridArrays: Any = ti.types.argpack(
    **dict.fromkeys(("x", "v", "C", "F", "U", "R", "volume"), ti.types.ndarray()),
    **dict.fromkeys(("partial", "touched", "nodes"), ti.types.ndarray()),
)
ParticlesToGridAdjointArrays: Any = ti.types.argpack(
    **dict.fromkeys(("x", "F", "U", "x_bar", "v_bar", "C_bar", "F_bar"), ti.types.ndarray()),
    **dict.fromkeys(("partial", "touched", "nodes", "nodes_bar"), ti.types.ndarray()),
)


@ti.kernel
def particles_to_grid(
    step: ParticlesToGridArrays,
    mass: float,
    lame_lambda: float,
    lame_mu: float,
    dt: float,
    drag: float,
    grid: ti.template(),
    scheme: ti.template(),
):
    """Momentum and mass of the particles to grid velocity and mass (algorithm 2.3, 2.4).

    Leaves (velocity, mass) in `step.nodes` and, for the corotated law, the rotations in `step.R`.
    """
    affine, atomic = ti.static(grid.affine, scheme.atomic)
    if ti.static(atomic):
        for i in range(grid.node_count):
            step.partial[i] = zero4()
    for task in range(task_count(step.x, atomic)):
        first, last, offset = begin_chunk(task, step.x, step.partial, step.touched, grid, atomic)
        for p in range(first, last):
            A = step.F[p] + step.U[p]
            if ti.static(scheme.model == FIXED_COROTATED):
                step.R[p] = rotation(A)
            T = kirchhoff_stress(A, step.R[p], lame_lambda, lame_mu, scheme.model)
            B = (-affine * dt * step.volume[p]) * T + mass * step.C[p]
            momentum = (1 - dt * drag) * mass * step.v[p]
            scatter(step.partial, offset, step.x[p], momentum, B, mass, grid, atomic)
    for row in range(grid.resolution**2):
        chunks = touching_chunks(row, step.touched, grid, atomic)
        if chunks != 0:  # no other row is ever read
            for i in range(row * grid.resolution, (row + 1) * grid.resolution):
                node = sum_chunks(i, chunks, step.partial, grid, atomic)
                m = node.w
                if m > SMALLEST_MASS and is_inside(i, grid):
                    step.nodes[i] = append(node.xyz / m, m)
                else:
                    step.nodes[i] = zero4()


@ti.kernel
def particles_to_grid_adjoint(
    step: ParticlesToGridAdjointArrays,
    smoothing_factor: float,
    dt: float,
    grid: ti.template(),
    scheme: ti.template(),
):
    """Adjoint of the grid step: Pi_bar and M_bar from the particles (algorithm 4.1, 4.2).

    `nodes_bar` receives (Pi_bar, M_bar, v, 0), what `grid_to_particles_adjoint` reads of a node.
    `smoothing_factor` is (1 - s) in the exact adjoint, 1 in the published one.
    """
    affine, atomic = ti.static(grid.affine, scheme.atomic)
    if ti.static(atomic):
        for i in range(grid.node_count):
            step.partial[i] = zero4()
    for task in range(task_count(step.x, atomic)):
        first, last, offset = begin_chunk(task, step.x, step.partial, step.touched, grid, atomic)
        for p in range(first, last):
            nu = step.v_bar[p] + dt * step.x_bar[p]
            A = step.F[p] + step.U[p]
            Gamma = step.C_bar[p] + (smoothing_factor * dt) * (step.F_bar[p] @ A.transpose())
            scatter(step.partial, offset, step.x[p], nu, affine * Gamma, 0.0, grid, atomic)
    for row in range(grid.resolution**2):
        chunks = touching_chunks(row, step.touched, grid, atomic)
        if chunks != 0:  # no other row is ever read
            for i in range(row * grid.resolution, (row + 1) * grid.resolution):
                v_node = step.nodes[i]
                if v_node.w > SMALLEST_MASS:
                    node = sum_chunks(i, chunks, step.partial, grid, atomic)
                    Pi_bar = node.xyz / v_node.w
                    M_bar = -v_node.xyz.dot(Pi_bar)
                    step.nodes_bar[i] = join(Pi_bar, M_bar, v_node.xyz)
                else:
                    step.nodes_bar[i] = ti.Vector.zero(float, 8)


@ti.func
def scatter(
    partial: ti.template(),
    offset: int,
    position,
    constant,
    linear,
    mass: float,
    grid: ti.template(),
    atomic: ti.template(),
):
    """Add w_ip (constant + linear d_ip, mass) to the nodes around one particle."""
    dx, width = ti.static(grid.dx, grid.width)
    base, u = base_and_offset(position, grid)
    wx, wy, wz = (
        b_spline.weights(u.x, width),
        b_spline.weights(u.y, width),
        b_spline.weights(u.z, width) * presence(position, grid),
    )
    corner = offset + flat_index(base, grid)
    by_x, by_y = append(linear[:, 0] * dx, 0.0), append(linear[:, 1] * dx, 0.0)
    by_z, center = append(linear[:, 2] * dx, 0.0), append(constant, mass)
    along_z = stencil.make_row(wz, center, by_z, u.z, width)
    for i in range(width):
        for j in range(width):
            w = wx[i] * wy[j]
            across = w * (by_x * (i - u.x) + by_y * (j - u.y))
            share = w * along_z + ti.Vector(
                [wz[k] * across[c] for k in range(width) for c in range(4)]
            )
            stencil.add_row(partial, row_index(corner, i, j, grid), share, width, atomic)


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
