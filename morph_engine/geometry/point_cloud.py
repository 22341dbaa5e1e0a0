"""Sets of points: their finite part, and how close together they lie."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.errors import MeshError

Points = npt.NDArray[np.float64]


def finite_points(positions: npt.ArrayLike) -> tuple[Points, npt.NDArray[np.bool_]]:
    """Split off particles that have no usable position.

    Returns:
        The finite positions [dx], shape [k, 3], float64, and the mask [n] that selects them.

    Raises:
        MeshError: The shape is not [n, 3].
    """
    points = np.asarray(positions)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(
            f"A point cloud has shape {list(points.shape)}.",
            "Pass one row of x, y, z per point, shape [n, 3].",
        )
    finite = np.isfinite(points)
    if finite.all():
        return points.astype(np.float64), np.ones(len(points), np.bool_)
    finite = finite.all(axis=1)
    return points[finite].astype(np.float64), finite


def target_points(target: npt.ArrayLike) -> Points:
    """The points of a target [dx], shape [m, 3], float64; unlike a running simulation, all finite.

    Raises:
        MeshError: The shape is not [m, 3], there is no point, or one is not finite.
    """
    points, finite = finite_points(target)
    if not finite.all():
        raise MeshError(
            f"{np.count_nonzero(~finite)} target points are not finite.",
            "Remove the rows with NaN or infinite coordinates.",
        )
    if not len(points):
        raise MeshError("The target has no points.", "Pass at least one target point.")
    return points


def extent(points: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """The least and the largest coordinates of points, shape [n, 3], n > 0.

    Column by column, which takes NumPy a tenth of the time of all together.
    """
    columns = points.T
    return np.array([c.min() for c in columns]), np.array([c.max() for c in columns])


def lengths(vectors: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Lengths of vectors, shape [n, 3], of their type, shape [n]."""
    found: npt.NDArray[Any] = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return found


def ball_around(positions: npt.ArrayLike) -> tuple[Points, float]:
    """Centre [3] and radius of a ball around points, shape [n, 3], those not finite overlooked."""
    finite, _ = finite_points(positions)
    if not len(finite):
        return np.zeros(3), 1.0
    least, most = extent(finite)
    centre = (least + most) / 2
    return centre, float(lengths(finite - centre).max())


def outer_radius(*clouds: npt.NDArray[Any]) -> float:
    """Largest distance of a point of some clouds, each shape [n, 3], from the origin [dx]."""
    return max(float(lengths(cloud).max()) for cloud in clouds)


def distinct_points(points: Points) -> tuple[Points, npt.NDArray[np.intp]]:
    """Points, each of them once, and how many there are of each, shape [k]; in any order.

    Equal points have equal sums of their coordinates by other factors. Where no two sums are equal,
    as nearly always, that spares the sorting of all three coordinates.
    """
    sums = np.sort((points * np.sqrt([2.0, 3.0, 5.0])).sum(axis=1))
    if (sums[1:] > sums[:-1]).all():
        return points, np.ones(len(points), np.intp)
    return np.unique(points, axis=0, return_counts=True)


def distance_to_other(
    distinct: Points,
    copies: npt.NDArray[np.intp],
    tree: scipy.spatial.cKDTree,
    *,
    bound: float = math.inf,
    workers: int = 1,
) -> Points:
    """Distance from each point to the nearest other one [dx], shape [k].

    Identical points are told apart first: a tree cannot split them, and searching them is O(n^2).

    Args:
        distinct: Points, no two of them equal [dx], shape [k, 3], float64.
        copies: How many there are of each, shape [k].
        tree: Tree of the distinct points.
        bound: Distances beyond this are infinite [dx].
        workers: Threads; -1 takes every core.
    """
    gap, _ = tree.query(distinct, k=[2], distance_upper_bound=bound, workers=workers)
    return np.where(copies > 1, 0.0, gap[:, 0])


def farthest_points(points: Points, count: int) -> npt.NDArray[np.intp]:
    """Indices of points that are far from each other, each the farthest from those before it.

    The first is the farthest from the mean of all [dx]; shape [min(count, n)].
    """
    chosen = [int(((points - points.mean(axis=0)) ** 2).sum(axis=1).argmax())]
    gap = np.full(len(points), np.inf)
    for _ in range(min(count, len(points)) - 1):
        gap = np.minimum(gap, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(gap.argmax()))
    return np.array(chosen)


def median_gap(points: npt.ArrayLike, neighbor: int) -> float:
    """Median over finite points, shape [n, 3], of the distance to their n-th neighbour [dx]."""
    finite, _ = finite_points(points)
    return float(np.median(scipy.spatial.cKDTree(finite).query(finite, [neighbor + 1])[0]))
