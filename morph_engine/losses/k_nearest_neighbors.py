"""The nearest points of one's own set (algorithm 8.3, 8.4)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morph_engine import backend


def k_nearest_neighbors(
    points: NDArray[Any], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The nearest other points of the same set [dx], shape [n, 3]; n - 1 where there are fewer.

    Returns:
        Indices and distances [dx], nearest first, shape [n, count] each.
    """
    count = min(count, len(points) - 1)
    workers = backend.active().threads or -1
    distance, index = cKDTree(points).query(points, k=count + 1, workers=workers)
    other = index != np.arange(len(points))[:, None]
    other[other.all(axis=1), -1] = False  # so many coincide that the point missed itself
    shape = (len(points), count)
    return index[other].reshape(shape), distance[other].reshape(shape)
