"""Forward and backward through a few steps with Taichi's automatic differentiation (Tape), float32.

A straightforward differentiable step: atomic scatter, one grid and one particle set per layer. Runs
in whatever Taichi runtime the engine has started; an `AutodiffSweep` must not outlive it.

No kernel here has a dynamic inner loop: through one, Taichi 1.7 returns wrong gradients without a
word (and overflows its stack beyond 32 rounds), and unrolling the whole stencil compiles for
minutes. So the parallel loop runs over all pairs of particle and node; the quicker form `by_rows`
runs over (particle, i, j) and unrolls k.
"""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from benchmarks.scene import (
    DRAG,
    DT,
    GRID_MIN,
    LAMBDA,
    MASS_FLOOR,
    MU,
    NODES_PER_AXIS,
    SMOOTHING,
    Layer,
    Scene,
)

INERTIA = 3.0  # c of the cubic B-spline
Vectors = ti.types.ndarray(dtype=ti.math.vec3, ndim=1)
Matrices = ti.types.ndarray(dtype=ti.math.mat3, ndim=1)
Scalars = ti.types.ndarray(dtype=ti.f32, ndim=1)
GridVectors = ti.types.ndarray(dtype=ti.math.vec3, ndim=3)
GridScalars = ti.types.ndarray(dtype=ti.f32, ndim=3)


class AutodiffSweep:
    """Layers 0..step_count of the scene under the loss sum_p pull_p . x_K,p, and d loss / d U."""

    name = "Taichi autodiff"

    def __init__(
        self, scene: Scene, pull: NDArray[np.float32], step_count: int, *, by_rows: bool = False
    ) -> None:
        self._to_grid = particles_to_grid_by_rows if by_rows else particles_to_grid
        self._to_particles = grid_to_particles_by_rows if by_rows else grid_to_particles
        count, shape = scene.particle_count, 3 * (NODES_PER_AXIS,)
        self.mass = scene.mass
        self.volume = ti.ndarray(ti.f32, count)
        self.volume.from_numpy(scene.volume)
        self.pull = vectors(count, pull, needs_grad=False)
        self.loss = ti.ndarray(ti.f32, (), needs_grad=True)
        zero = Layer(*(0 * a for a in (scene.layer.x, scene.layer.v, scene.layer.C, scene.layer.F)))
        self.layers = [
            (vectors(count, a.x), vectors(count, a.v), matrices(count, a.C), matrices(count, a.F))
            for a in [scene.layer] + step_count * [zero]
        ]
        self.U = [matrices(count, scene.U) for _ in range(step_count)]
        self.B = [matrices(count, zero.C) for _ in range(step_count)]
        self.grids = [
            (
                ti.ndarray(ti.math.vec3, shape, needs_grad=True),
                ti.ndarray(ti.f32, shape, needs_grad=True),
                ti.ndarray(ti.math.vec3, shape, needs_grad=True),
            )
            for _ in range(step_count)
        ]

    def advance(self) -> None:
        """All steps forward, then the tape backward."""
        for array in (self.loss, *(a for grid in self.grids for a in grid)):
            array.fill(0.0)
        for _, v, C, _ in self.layers[1:]:
            v.fill(0.0)
            C.fill(0.0)
        with ti.ad.Tape(loss=self.loss):
            for k, (momentum, mass, velocity) in enumerate(self.grids):
                (x, v, C, F), (x_next, v_next, C_next, F_next) = self.layers[k : k + 2]
                affine_momentum(C, F, self.U[k], self.volume, self.mass, self.B[k])
                self._to_grid(x, v, self.B[k], self.mass, momentum, mass)
                grid_velocity(momentum, mass, velocity)
                self._to_particles(x, velocity, v_next, C_next)
                move(x, F, self.U[k], v_next, C_next, x_next, F_next)
            pulled(self.layers[-1][0], self.pull, self.loss)

    def result(self) -> Layer:
        """Return the last layer."""
        return Layer(*(a.to_numpy() for a in self.layers[-1]))

    def control_gradients(self) -> list[NDArray[np.float32]]:
        """Return d loss / d U of every layer, each [particle_count, 3, 3]."""
        return [U.grad.to_numpy() for U in self.U]


def vectors(count: int, values: Any, *, needs_grad: bool = True) -> Any:
    """Return a Taichi array of 3-vectors."""
    array = ti.ndarray(ti.math.vec3, count, needs_grad=needs_grad)
    array.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
    return array


def matrices(count: int, values: Any) -> Any:
    """Return a Taichi array of 3x3 matrices."""
    array = ti.ndarray(ti.math.mat3, count, needs_grad=True)
    array.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
    return array


@ti.func
def cubic(d):
    outer = ti.max(2.0 - ti.abs(d), 0.0)
    inner = ti.max(1.0 - ti.abs(d), 0.0)
    return (outer**3 - 4.0 * inner**3) / 6.0


@ti.func
def base_of(u):
    return ti.math.clamp(ti.floor(u, ti.i32) - 1, 0, NODES_PER_AXIS - 4)


@ti.kernel
def affine_momentum(
    C: Matrices, F: Matrices, U: Matrices, volume: Scalars, mass: ti.f32, B: Matrices
):
    for p in C:
        A = F[p] + U[p]
        pressure = LAMBDA * ti.log(A.determinant()) - MU
        tau = MU * A @ A.transpose() + pressure * ti.Matrix.identity(ti.f32, 3)
        B[p] = mass * C[p] - INERTIA * DT * volume[p] * tau


@ti.kernel
def particles_to_grid(
    x: Vectors,
    v: Vectors,
    B: Matrices,
    mass: ti.f32,
    grid_momentum: GridVectors,
    grid_mass: GridScalars,
):
    for p, i, j, k in ti.ndrange(x.shape[0], 4, 4, 4):
        u = x[p] - GRID_MIN
        base = base_of(u)
        node = base + ti.Vector([i, j, k])
        d = node - u
        weight = cubic(d[0]) * cubic(d[1]) * cubic(d[2])
        grid_momentum[node] += weight * ((1 - DT * DRAG) * mass * v[p] + B[p] @ d)
        grid_mass[node] += weight * mass


@ti.kernel
def particles_to_grid_by_rows(
    x: Vectors,
    v: Vectors,
    B: Matrices,
    mass: ti.f32,
    grid_momentum: GridVectors,
    grid_mass: GridScalars,
):
    for p, i, j in ti.ndrange(x.shape[0], 4, 4):
        u = x[p] - GRID_MIN
        base = base_of(u)
        for k in ti.static(range(4)):
            node = base + ti.Vector([i, j, k])
            d = node - u
            weight = cubic(d[0]) * cubic(d[1]) * cubic(d[2])
            grid_momentum[node] += weight * ((1 - DT * DRAG) * mass * v[p] + B[p] @ d)
            grid_mass[node] += weight * mass


@ti.kernel
def grid_velocity(momentum: GridVectors, mass: GridScalars, velocity: GridVectors):
    for node in ti.grouped(mass):
        if mass[node] > MASS_FLOOR:
            velocity[node] = momentum[node] / mass[node]


@ti.kernel
def grid_to_particles(x: Vectors, grid: GridVectors, v_next: Vectors, C_next: Matrices):
    for p, i, j, k in ti.ndrange(x.shape[0], 4, 4, 4):
        u = x[p] - GRID_MIN
        base = base_of(u)
        v = ti.Vector.zero(ti.f32, 3)
        C = ti.Matrix.zero(ti.f32, 3, 3)
        node = base + ti.Vector([i, j, k])
        d = node - u
        share = cubic(d[0]) * cubic(d[1]) * cubic(d[2]) * grid[node]
        v += share
        C += INERTIA * share.outer_product(d)
        v_next[p] += v
        C_next[p] += C


@ti.kernel
def grid_to_particles_by_rows(x: Vectors, grid: GridVectors, v_next: Vectors, C_next: Matrices):
    for p, i, j in ti.ndrange(x.shape[0], 4, 4):
        u = x[p] - GRID_MIN
        base = base_of(u)
        v = ti.Vector.zero(ti.f32, 3)
        C = ti.Matrix.zero(ti.f32, 3, 3)
        for k in ti.static(range(4)):
            node = base + ti.Vector([i, j, k])
            d = node - u
            share = cubic(d[0]) * cubic(d[1]) * cubic(d[2]) * grid[node]
            v += share
            C += INERTIA * share.outer_product(d)
        v_next[p] += v
        C_next[p] += C


@ti.kernel
def move(
    x: Vectors,
    F: Matrices,
    U: Matrices,
    v_next: Vectors,
    C_next: Matrices,
    x_next: Vectors,
    F_next: Matrices,
):
    for p in x:
        A = F[p] + U[p]
        x_next[p] = x[p] + DT * v_next[p]
        F_next[p] = (1 - SMOOTHING) * (A + DT * C_next[p] @ A) + SMOOTHING * F[p]


@ti.kernel
def pulled(x: Vectors, pull: Vectors, loss: ti.types.ndarray(dtype=ti.f32, ndim=0)):
    for p in x:
        loss[None] += pull[p].dot(x[p])
