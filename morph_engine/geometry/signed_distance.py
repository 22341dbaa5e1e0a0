"""Signed distance of a solid on a cubic lattice: negative inside."""

from __future__ import annotations

from typing import Any

import lazy_loader as lazy
import numpy as np
import scipy
from numpy.typing import NDArray

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.winding_number import inside

igl: Any = lazy.load("igl")

COARSENING = 4
"""Lattice steps between the points at which distances far from the surface are computed."""


def mesh_distance(mesh: Mesh, axis: NDArray[np.float64], band: float) -> NDArray[np.float32]:
    """Signed distance to a mesh, which may be open: the winding number tells what is inside.

    Exact where the distance interpolated between every fourth point is below `band`: so at the
    surface, but for what is thinner than their gaps, and a little less far from it where it bends.

    Args:
        mesh: The mesh [dx].
        axis: Coordinates of the lattice along each axis [dx], ascending evenly, shape [n].
        band: Interpolated distance up to which each lattice point gets its own [dx].

    Returns:
        Distances [dx], shape [n, n, n].
    """
    coarse_axis = np.append(axis[:-1:COARSENING], axis[-1])
    coarse = _exact(mesh, _points(coarse_axis)).reshape((len(coarse_axis),) * 3)
    distance = coarse.astype(np.float32)
    for along in (2, 1, 0):
        distance = _interpolated(distance, coarse_axis, axis, along)
    near = np.nonzero(np.abs(distance) < band)
    distance[near] = _exact(mesh, np.stack([axis[index] for index in near], axis=1))
    return np.ascontiguousarray(distance)


def cloud_distance(
    points: NDArray[Any], axis: NDArray[np.float64], radius: float
) -> NDArray[np.float32]:
    """Signed distance to a solid given by points that fill it, as the union of balls around them.

    Args:
        points: The points [dx], shape [n, 3].
        axis: Coordinates of the lattice along each axis [dx], ascending evenly, shape [n].
        radius: Of the balls [dx]; the surface lies half a ball inside their union.

    Returns:
        Distances [dx], shape [n, n, n].
    """
    nearest = scipy.spatial.cKDTree(points).query(_points(axis), distance_upper_bound=radius)[0]
    filled = np.isfinite(nearest).reshape((len(axis),) * 3)
    step = axis[1] - axis[0]
    edt = scipy.ndimage.distance_transform_edt
    distance: NDArray[np.float64] = step * (edt(~filled) - edt(filled)) + radius / 2
    return distance.astype(np.float32)


def _interpolated(
    field: NDArray[np.float32],
    coarse_axis: NDArray[np.float64],
    axis: NDArray[np.float64],
    along: int,
) -> NDArray[np.float32]:
    """A field on a finer axis, linear between the points of the coarse one."""
    coarse = np.moveaxis(field, along, 0)
    fine = np.empty((len(axis), *coarse.shape[1:]), np.float32)
    cells = np.clip(np.searchsorted(coarse_axis, axis) - 1, 0, len(coarse_axis) - 2)
    edges, beyond = np.diff(coarse_axis)[cells], axis - coarse_axis[cells]
    for layer, cell, edge, length in zip(fine, cells, edges, beyond, strict=True):
        slope = (coarse[cell + 1] - coarse[cell]) / edge
        layer[:] = coarse[cell] + slope * length
    return np.moveaxis(fine, 0, along)


def _points(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _exact(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    squared, _, _ = igl.point_mesh_squared_distance(
        points, mesh.vertices, mesh.faces.astype(np.int64)
    )
    distance: NDArray[np.float64] = np.sqrt(squared)
    distance[inside(mesh, points)] *= -1
    return distance
