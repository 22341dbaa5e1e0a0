"""The small scene of all four statements: a few targets in the plane, a cluster in one cell."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.chamfer import ChamferLoss
from chamfer_morph.reproduction.planar.shapes import directions

Points = npt.NDArray[np.float64]

TARGETS: Points = np.array(
    [[0.0, 0.0], [1.0, 0.1], [0.6, 0.9], [-0.4, 0.9], [-1.0, 0.1], [-0.5, -0.9], [0.6, -0.8]]
)
"""Seven targets; the first one, q*, lies amid the others. Shape [7, 2], float64."""

CENTER: Points = TARGETS[0]
"""q*, the nearest target of the whole cluster."""


FORWARD = ChamferLoss(reverse=0.0)
"""The forward term alone."""


def cluster(count: int = 8, *, seed: int = 0) -> Points:
    """Points whose nearest target is q*, off centre, irregular and well apart, [count, 2]."""
    turn = np.arange(count) + 0.5
    radius, angle = 0.22 * np.sqrt(turn / count), np.pi * (3 - np.sqrt(5)) * turn
    spiral = radius[:, None] * directions(angle)
    shift = np.random.default_rng(seed).uniform(-0.03, 0.03, (count, 2))
    points: Points = np.array([0.15, 0.1]) + spiral + shift
    return points


def elsewhere(count: int = 12, *, seed: int = 1) -> Points:
    """Points in the cells of the other targets, shape [count, 2]."""
    angle = 2 * np.pi * (np.arange(count) + 0.3) / count
    radius = 1 + 0.1 * np.random.default_rng(seed).uniform(-1, 1, count)
    points: Points = radius[:, None] * directions(angle)
    return points


def spread(points: Points) -> float:
    """Root mean square distance from the centroid."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
