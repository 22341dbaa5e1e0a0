"""The local repulsive force between near neighbours (algorithm 10)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Points = npt.NDArray[np.float64]

LEAST_DISTANCE = 1e-8
"""Distances count as at least this, so that coincident points get no infinite force."""


def repulsion(
    points: Points,
    *,
    neighbors: int,
    power: float = 2.0,
    average: bool = True,
    reaction: bool = False,
) -> Points:
    """Force that pushes each point away from its k nearest others.

        F_i = 1/k sum over j in kNN(i) of (p_i - p_j) / |p_i - p_j|^(power + 1)

    Args:
        points: p, shape [n, d], float64, n > neighbors.
        neighbors: k.
        power: The force of one neighbour has length 1 / distance^power.
        average: Divide by k.
        reaction: Each neighbour j also feels the opposite of what it does to i. Then F is the
            negative gradient of a penalty and sums to zero over all points; else it is not.

    Returns:
        F, shape [n, d].
    """
    index = cKDTree(points).query(points, neighbors + 1)[1][:, 1:]
    away = points[:, None] - points[index]
    distance = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), LEAST_DISTANCE)
    push = away / distance ** (power + 1)
    force: Points = push.sum(axis=1)
    if reaction:
        np.add.at(force, index, -push)
    return force / neighbors if average else force
