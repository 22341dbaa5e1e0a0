"""The step in NVIDIA Warp on its CPU device, float32.

Warp runs a CPU launch on one thread, so its atomic additions cost what plain ones do.
"""

from typing import Any, ClassVar

import numpy as np

from benchmarks import scene as constants
from benchmarks.peers import PeerMissingError
from benchmarks.scene import Layer, Scene

try:
    import warp as wp
except ImportError as error:
    raise PeerMissingError("warp-lang is not installed (pip install warp-lang)") from error

wp.config.log_level = wp.LOG_ERROR  # it announces itself on stdout
wp.set_module_options({"enable_backward": False})

INERTIA = wp.constant(wp.float32(3.0))  # c of the cubic B-spline
DT = wp.constant(wp.float32(constants.DT))
DRAG = wp.constant(wp.float32(constants.DRAG))
GRID_MIN = wp.constant(wp.float32(constants.GRID_MIN))
LAMBDA = wp.constant(wp.float32(constants.LAMBDA))
MU = wp.constant(wp.float32(constants.MU))
SMOOTHING = wp.constant(wp.float32(constants.SMOOTHING))
MASS_FLOOR = wp.constant(wp.float32(constants.MASS_FLOOR))
LAST_BASE = wp.constant(constants.NODES_PER_AXIS - 4)


class WarpStep:
    """A `Stepper` in Warp; `grid` holds (momentum or velocity, mass) per node."""

    name: ClassVar[str] = "NVIDIA Warp CPU"

    def __init__(self, scene: Scene) -> None:
        layer, count, shape = scene.layer, scene.particle_count, 3 * (constants.NODES_PER_AXIS,)

        def vectors(a: Any) -> Any:
            return wp.array(a, dtype=wp.vec3, device="cpu")

        def matrices(a: Any) -> Any:
            return wp.array(a, dtype=wp.mat33, device="cpu")

        volume = wp.array(scene.volume, dtype=wp.float32, device="cpu")
        x, v, C, F = vectors(layer.x), vectors(layer.v), matrices(layer.C), matrices(layer.F)
        U, mass = matrices(scene.U), float(scene.mass)
        self.next = tuple(wp.zeros_like(a) for a in (x, v, C, F))
        self.grid = wp.zeros(shape, dtype=wp.vec4, device="cpu")
        self.launches = [
            wp.launch(kernel, dim, inputs=inputs, device="cpu", record_cmd=True)
            for kernel, dim, inputs in (
                (particles_to_grid, count, [x, v, C, F, U, volume, mass, self.grid]),
                (grid_velocity, shape, [self.grid]),
                (grid_to_particles, count, [x, F, U, self.grid, *self.next]),
            )
        ]

    def advance(self) -> None:
        """One step."""
        self.grid.zero_()
        for launch in self.launches:
            launch.launch()

    def result(self) -> Layer:
        """Return the layer after the scene's."""
        return Layer(*(np.array(a.numpy()) for a in self.next))


@wp.func
def cubic(d: float):
    outer = wp.max(2.0 - wp.abs(d), 0.0)
    inner = wp.max(1.0 - wp.abs(d), 0.0)
    return (outer * outer * outer - 4.0 * inner * inner * inner) * (1.0 / 6.0)


@wp.func
def base_of(u: float):
    return wp.clamp(int(wp.floor(u)) - 1, 0, LAST_BASE)


@wp.func
def xyz(a: wp.vec4):
    return wp.vec3(a[0], a[1], a[2])


@wp.func
def column(B: wp.mat33, b: int):
    return wp.vec3(B[0, b], B[1, b], B[2, b])


@wp.func
def weights(d: float):
    return wp.vec4(cubic(d), cubic(d + 1.0), cubic(d + 2.0), cubic(d + 3.0))


@wp.kernel
def particles_to_grid(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    C: wp.array(dtype=wp.mat33),
    F: wp.array(dtype=wp.mat33),
    U: wp.array(dtype=wp.mat33),
    volume: wp.array(dtype=wp.float32),
    mass: wp.float32,
    grid: wp.array3d(dtype=wp.vec4),
):
    p = wp.tid()
    A = F[p] + U[p]
    pressure = LAMBDA * wp.log(wp.determinant(A)) - MU
    tau = MU * A * wp.transpose(A) + pressure * wp.identity(n=3, dtype=wp.float32)
    B = mass * C[p] - (INERTIA * DT * volume[p]) * tau
    u = x[p] - wp.vec3(GRID_MIN, GRID_MIN, GRID_MIN)
    bi, bj, bk = base_of(u[0]), base_of(u[1]), base_of(u[2])
    d = wp.vec3(float(bi), float(bj), float(bk)) - u
    wi, wj, wk = weights(d[0]), weights(d[1]), weights(d[2])
    start = (1.0 - DT * DRAG) * mass * v[p] + B * d
    for i in range(4):
        for j in range(4):
            w = wi[i] * wj[j]
            line = start + float(i) * column(B, 0) + float(j) * column(B, 1)
            for k in range(4):
                m = line + float(k) * column(B, 2)
                share = (w * wk[k]) * wp.vec4(m[0], m[1], m[2], mass)
                wp.atomic_add(grid, bi + i, bj + j, bk + k, share)


@wp.kernel
def grid_velocity(grid: wp.array3d(dtype=wp.vec4)):
    i, j, k = wp.tid()
    node = grid[i, j, k]
    if node[3] > MASS_FLOOR:
        grid[i, j, k] = node / node[3]
    else:
        grid[i, j, k] = wp.vec4()


@wp.kernel
def grid_to_particles(
    x: wp.array(dtype=wp.vec3),
    F: wp.array(dtype=wp.mat33),
    U: wp.array(dtype=wp.mat33),
    grid: wp.array3d(dtype=wp.vec4),
    x_next: wp.array(dtype=wp.vec3),
    v_next: wp.array(dtype=wp.vec3),
    C_next: wp.array(dtype=wp.mat33),
    F_next: wp.array(dtype=wp.mat33),
):
    p = wp.tid()
    u = x[p] - wp.vec3(GRID_MIN, GRID_MIN, GRID_MIN)
    bi, bj, bk = base_of(u[0]), base_of(u[1]), base_of(u[2])
    d = wp.vec3(float(bi), float(bj), float(bk)) - u
    wi, wj, wk = weights(d[0]), weights(d[1]), weights(d[2])
    v = wp.vec4()
    moment_i = wp.vec4()
    moment_j = wp.vec4()
    moment_k = wp.vec4()
    for i in range(4):
        for j in range(4):
            w = wi[i] * wj[j]
            line = wp.vec4()
            for k in range(4):
                share = (w * wk[k]) * grid[bi + i, bj + j, bk + k]
                line += share
                moment_k += (d[2] + float(k)) * share
            v += line
            moment_i += (d[0] + float(i)) * line
            moment_j += (d[1] + float(j)) * line
    C = INERTIA * wp.matrix_from_cols(xyz(moment_i), xyz(moment_j), xyz(moment_k))
    A = F[p] + U[p]
    v_next[p] = xyz(v)
    C_next[p] = C
    x_next[p] = x[p] + DT * xyz(v)
    F_next[p] = (1.0 - SMOOTHING) * (A + DT * C * A) + SMOOTHING * F[p]
