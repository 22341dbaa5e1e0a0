"""Grid mass loss: how the mass on the grid differs from the target's (algorithm 3)."""

from dataclasses import replace
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.backend import CPU_CHUNK_STRIDE
from morph_engine.mpm import b_spline, stencil
from morph_engine.mpm.grid import (
    Grid,
    base_and_offset,
    flat_index,
    is_inside,
    presence,
    row_index,
)
from morph_engine.mpm.private_grids import (
    PrivateGrids,
    begin_chunk,
    sum_chunks,
    task_count,
    touching_chunks,
)

SHIFT = 1.0 + 1e-4  # 1 + eps inside the logarithms
SMALLEST_MASS = 1e-12


class GridMass:
    """Mass of a fixed number of points of equal mass on the grid (algorithm 1.3, 3)."""

    def __init__(self, point_count: int, point_mass: float, grid: Grid) -> None:
        self.point_count = point_count
        self.point_mass = point_mass
        self.grid: Grid = replace(grid, leaky=True)
        self._private = PrivateGrids(grid, values=1)
        self.nodes: Any = backend.active().scalars(grid.node_count)

    def gather(self, x: Any) -> Any:
        """Node masses of points at x [dx], shape [point_count, 3]; shape [node_count]."""
        private = self._private
        _mass_to_grid(
            x, private.partial, private.touched, self.nodes, self.point_mass,
            self.grid, private.atomic,
        )  # fmt: skip
        return self.nodes

    def pull_back(self, x: Any, slope: Any, x_bar: Any, weight: float = 1.0) -> None:
        """Write weight * sum_i slope_i dM_i/dx_p at x [dx] to x_bar, both of shape [n, 3].

        `slope` is the derivative by the node masses, shape [node_count].
        """
        factor = weight * self.point_mass
        _mass_to_grid_adjoint(x, slope, x_bar, self.point_count, factor, self.grid)

    def rest_volumes(self, x: Any) -> NDArray[Any]:
        """Rest volumes of particles at x from the density they see [dx^3] (algorithm 1.3)."""
        volumes = backend.active().scalars(self.point_count)
        _volumes(x, self.gather(x), volumes, self.point_count, self.point_mass, self.grid)
        return np.asarray(volumes.to_numpy())


class GridMassLoss:
    """L = 1/2 sum_i (ln(M_i + 1 + eps) - ln(M*_i + 1 + eps))^2 and its gradient (algorithm 3).

    Args:
        target: Target points [dx], device array, shape [m, 3].
        particle_count: Number of particles.
        point_mass: Mass of each particle and of each target point.
        grid: Background grid.
        outside_factor: Factor on the gradient of nodes without target mass.
    """

    def __init__(
        self,
        target: Any,
        *,
        particle_count: int,
        point_mass: float,
        grid: Grid,
        outside_factor: float,
    ) -> None:
        self._goal = GridMass(target.shape[0], point_mass, grid).gather(target)
        self._mass = GridMass(particle_count, point_mass, grid)
        self._slope = backend.active().scalars(grid.node_count)
        self._plane_sums = backend.active().scalars(grid.resolution)
        self._outside_factor = outside_factor
        self._grid = grid

    def evaluate(self, x: Any) -> float:
        """The loss of particles at x [dx], shape [n, 3]."""
        _log_mass_loss(
            self._mass.gather(x), self._goal, self._slope, self._plane_sums,
            self._outside_factor, self._grid,
        )  # fmt: skip
        return float(self._plane_sums.to_numpy().sum(dtype=np.float64))

    def gradient(self, x: Any, x_bar: Any, weight: float = 1.0) -> None:
        """Write weight * gradient at the x evaluated last to x_bar, shape [n, 3]."""
        self._mass.pull_back(x, self._slope, x_bar, weight)


@ti.kernel
def _mass_to_grid(
    x: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    touched: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    point_mass: float,
    grid: ti.template(),
    atomic: ti.template(),
):
    """M_i = sum_p w_ip m, on nodes inside the domain."""
    width = ti.static(grid.width)
    if ti.static(atomic):
        for i in range(grid.node_count):
            partial[i] = 0.0
    for task in range(task_count(x, atomic)):
        first, last, offset = begin_chunk(task, x, partial, touched, grid, atomic)
        for p in range(first, last):
            base, u = base_and_offset(x[p], grid)
            wx, wy = b_spline.weights(u.x, width), b_spline.weights(u.y, width)
            wz = b_spline.weights(u.z, width) * (presence(x[p], grid) * point_mass)
            corner = offset + flat_index(base, grid)
            for i in range(width):
                for j in range(width):
                    share = (wx[i] * wy[j]) * wz
                    start = row_index(corner, i, j, grid)
                    if ti.static(atomic):
                        for k in ti.static(range(width)):
                            ti.atomic_add(partial[start + k], share[k])
                    else:
                        row = ti.Vector([partial[start + k] for k in range(width)]) + share
                        for k in ti.static(range(width)):
                            partial[start + k] = row[k]
    for row in range(grid.resolution**2):
        chunks = touching_chunks(row, touched, grid, atomic)
        for i in range(row * grid.resolution, (row + 1) * grid.resolution):
            mass[i] = 0.0
            if chunks != 0 and is_inside(i, grid):
                mass[i] = sum_chunks(i, chunks, partial, grid, atomic)


@ti.kernel
def _mass_to_grid_adjoint(
    x: ti.types.ndarray(),
    slope: ti.types.ndarray(),
    x_bar: ti.types.ndarray(),
    count: int,
    factor: float,
    grid: ti.template(),
):
    """x_bar_p = factor sum_i dL/dM_i grad w_ip."""
    dx, width = ti.static(grid.dx, grid.width)
    for p in range(count):
        base, u = base_and_offset(x[p], grid)
        wx, gx = b_spline.weights(u.x, width), b_spline.weight_derivatives(u.x, width)
        wy, gy = b_spline.weights(u.y, width), b_spline.weight_derivatives(u.y, width)
        wz, gz = b_spline.weights(u.z, width), b_spline.weight_derivatives(u.z, width)
        corner = flat_index(base, grid)
        # Sums over x and y, for each z separately.
        memory = stencil.in_memory(u)
        flat, by_x, by_y = [stencil.zero_sums(width) for _ in range(3)]
        for i in range(width):
            plane, plane_y = ti.Vector.zero(float, width), ti.Vector.zero(float, width)
            for j in ti.static(range(width)):
                first = row_index(corner, i, j, grid)
                values = ti.Vector([slope[first + k] for k in range(width)])
                plane += wy[j] * values
                plane_y += gy[j] * values
            stencil.accumulate(flat, memory, wx[i], plane)
            stencil.accumulate(by_x, memory, gx[i], plane)
            stencil.accumulate(by_y, memory, wx[i], plane_y)
        gradient = ti.Vector.zero(float, 3)
        for k in ti.static(range(width)):
            gradient.x += wz[k] * by_x[memory, k]
            gradient.y += wz[k] * by_y[memory, k]
            gradient.z += gz[k] * flat[memory, k]
        x_bar[p] = gradient * (presence(x[p], grid) * (factor / dx))


@ti.kernel
def _log_mass_loss(
    mass: ti.types.ndarray(),
    goal: ti.types.ndarray(),
    slope: ti.types.ndarray(),
    plane_sums: ti.types.ndarray(),
    outside_factor: float,
    grid: ti.template(),
):
    """Loss summed per x plane, and the factor of each node in the gradient."""
    plane_size = ti.static(grid.resolution**2)
    for task in range(grid.resolution * CPU_CHUNK_STRIDE):
        if task % CPU_CHUNK_STRIDE == 0:
            plane = task // CPU_CHUNK_STRIDE
            total = 0.0
            for i in range(plane * plane_size, (plane + 1) * plane_size):
                shifted = mass[i] + SHIFT
                g = ti.log(shifted / (goal[i] + SHIFT))
                total += 0.5 * g * g
                factor = ti.select(goal[i] > SMALLEST_MASS, 1.0, outside_factor)
                slope[i] = factor * g / shifted
            plane_sums[plane] = total


@ti.kernel
def _volumes(
    x: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    volumes: ti.types.ndarray(),
    count: int,
    point_mass: float,
    grid: ti.template(),
):
    """V_p = m dx^3 / sum_i w_ip M_i."""
    dx, width = ti.static(grid.dx, grid.width)
    for p in range(count):
        base, u = base_and_offset(x[p], grid)
        wx = b_spline.weights(u.x, width)
        wy = b_spline.weights(u.y, width)
        wz = b_spline.weights(u.z, width)
        corner = flat_index(base, grid)
        density = 0.0
        for i in range(width):
            for j in range(width):
                first = row_index(corner, i, j, grid)
                for k in ti.static(range(width)):
                    density += wx[i] * wy[j] * wz[k] * mass[first + k]
        volumes[p] = point_mass * dx**3 / ti.max(density, SMALLEST_MASS)
