"""The local regularisers of the paper as penalties with exact gradients (algorithm 8.4).

All are invariant under translation. Neighbour lists are given, so that a test can let them end at
a cluster's boundary or cross it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Points = npt.NDArray[np.float64]
Lists = npt.NDArray[np.intp]
Penalty = Callable[[Points, Lists], tuple[float, Points]]
"""Value and gradient, shape [n, 2], of points, shape [n, 2], with neighbour lists, shape [n, k]."""


def neighbor_lists(points: Points, count: int) -> Lists:
    """The nearest others of each point, shape [n, count]."""
    lists: Lists = cKDTree(points).query(points, count + 1)[1][:, 1:]
    return lists


def repulsion_penalty(points: Points, lists: Lists) -> tuple[float, Points]:
    """R = 1/(k n) sum_i sum_r 1 / |p_i - p_r|^2 over each point's list; gradient at both ends."""
    away = points[:, None] - points[lists]
    square = np.sum(away**2, axis=-1, keepdims=True)
    pull = -2 * away / square**2 / lists.size
    gradient = pull.sum(axis=1)
    np.add.at(gradient, lists, -pull)
    return float(np.sum(1 / square)) / lists.size, gradient


def smoothness_penalty(points: Points, lists: Lists) -> tuple[float, Points]:
    """R = 1/n sum_i |p_i - mean_r p_r|^2 (Laplacian); gradient at both ends."""
    count, k = lists.shape
    offset = points - points[lists].mean(axis=1)
    gradient = 2 * offset / count
    np.add.at(gradient, lists, np.repeat(-2 * offset[:, None] / (count * k), k, axis=1))
    return float(np.sum(offset**2)) / count, gradient


def extent_penalty(points: Points, _: Lists) -> tuple[float, Points]:
    """R = (A - 1)^2 with A the area of the bounding box; it acts on its extreme points only."""
    low, high = points.argmin(axis=0), points.argmax(axis=0)
    edges = points.max(axis=0) - points.min(axis=0)
    excess = float(edges.prod()) - 1
    gradient = np.zeros_like(points)
    for axis in (0, 1):
        slope = 2 * excess * edges[1 - axis]
        gradient[high[axis], axis] += slope
        gradient[low[axis], axis] -= slope
    return excess**2, gradient


PENALTIES: dict[str, Penalty] = {
    "repulsion": repulsion_penalty,
    "smoothness": smoothness_penalty,
    "volume": extent_penalty,
}
