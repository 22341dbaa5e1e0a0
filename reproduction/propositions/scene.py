"""The small scene of all four statements: a few targets in the plane, a cluster in one cell."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.chamfer import chamfer_loss
from chamfer_morph.reproduction.planar.shapes import directions

Points = npt.NDArray[np.float64]
Gradient = Callable[[Points], Points]

TARGETS: Points = np.array(
    [[0.0, 0.0], [1.0, 0.1], [0.6, 0.9], [-0.4, 0.9], [-1.0, 0.1], [-0.5, -0.9], [0.6, -0.8]]
)
"""Seven targets; the first one, q*, lies amid the others. Shape [7, 2], float64."""

CENTER: Points = TARGETS[0]
"""q*, the nearest target of the whole cluster."""


def chamfer_gradient(points: Points, *, forward: float = 1.0, reverse: float = 1.0) -> Points:
    """Gradient of the Chamfer loss with these weights of its terms, shape [n, 2]."""
    return chamfer_loss(points, TARGETS, forward=forward, reverse=reverse)[1]


forward_gradient: Gradient = partial(chamfer_gradient, reverse=0.0)
reverse_gradient: Gradient = partial(chamfer_gradient, forward=0.0)


def cluster() -> Points:
    """Points whose nearest target is q*, off centre, irregular and well apart, shape [8, 2]."""
    turn = np.arange(8) + 0.5
    radius, angle = 0.22 * np.sqrt(turn / 8), np.pi * (3 - np.sqrt(5)) * turn
    spiral = radius[:, None] * directions(angle)
    shift = np.random.default_rng(0).uniform(-0.03, 0.03, (8, 2))
    points: Points = np.array([0.15, 0.1]) + spiral + shift
    return points


def elsewhere() -> Points:
    """Points in the cells of the other targets, shape [12, 2]."""
    angle = 2 * np.pi * (np.arange(12) + 0.3) / 12
    radius = 1 + 0.1 * np.random.default_rng(1).uniform(-1, 1, 12)
    points: Points = radius[:, None] * directions(angle)
    return points


def spread(points: Points) -> float:
    """Root mean square distance from the centroid."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
