"""Nodes of a raster that are near points, marked in a box that holds them all."""

import numpy as np
import taichi as ti
from numpy.typing import NDArray


def overlap(
    clouds: tuple[NDArray[np.float64], NDArray[np.float64]],
    corner: NDArray[np.float64],
    size: tuple[int, int, int],
    *,
    radius: float,
    step: float,
) -> tuple[int, int, int]:
    """Number of raster nodes near the first of two clouds, near the second, and near both.

    Args:
        clouds: Points [dx], each shape [n, 3], float64.
        corner: Node (0, 0, 0) of the raster [dx].
        size: Nodes along each axis of a box that holds all that are near.
        radius: Nodes closer than this are near [dx].
        step: Of the raster [dx].
    """
    marks = np.zeros(size, np.uint8)
    for bit, points in enumerate(clouds):
        mark_near(points, marks, *corner.tolist(), radius, step, 1 << bit)
    first, second = marks & 1, marks & 2
    near = (first, second, first & (second >> 1))
    one, other, both = (int(np.count_nonzero(nodes)) for nodes in near)
    return one, other, both


@ti.kernel
def mark_near(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),
    marks: ti.types.ndarray(dtype=ti.u8, ndim=3),
    corner_x: ti.f64,
    corner_y: ti.f64,
    corner_z: ti.f64,
    radius: ti.f64,
    step: ti.f64,
    bit: ti.i32,
):
    """Set a bit of the nodes closer than the radius to a point.

    Threads may set the same one at a time, to the same.
    """
    reach = radius / step
    for p in range(points.shape[0]):
        x = (points[p, 0] - corner_x) / step
        y = (points[p, 1] - corner_y) / step
        z = (points[p, 2] - corner_z) / step
        low_x = ti.cast(ti.ceil(x - reach), ti.i32)
        low_y = ti.cast(ti.ceil(y - reach), ti.i32)
        low_z = ti.cast(ti.ceil(z - reach), ti.i32)
        for i in range(low_x, ti.cast(ti.floor(x + reach), ti.i32) + 1):
            for j in range(low_y, ti.cast(ti.floor(y + reach), ti.i32) + 1):
                for k in range(low_z, ti.cast(ti.floor(z + reach), ti.i32) + 1):
                    if (i - x) ** 2 + (j - y) ** 2 + (k - z) ** 2 < reach * reach:
                        marks[i, j, k] = marks[i, j, k] | ti.cast(bit, ti.u8)
