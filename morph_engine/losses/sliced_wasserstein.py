"""Sliced Wasserstein distance: optimal transport along many lines, where sorting solves it.

Bonneel et al., "Sliced and Radon Wasserstein barycenters of measures", 2015.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from morph_engine import backend

Points = NDArray[np.float64]

DIMENSIONS = 3


class SlicedWasserstein:
    """L = 3/2 mean_theta W_2^2 of the projections on lines of direction theta.

    The factor 3 makes a shift of all points by d cost d^2 / 2, as in the Chamfer losses. Projected
    on a line, the particle of rank r takes the part of the target between the quantiles r / n and
    (r + 1) / n; t_r is the mean of that part, and the gradient by a particle is
    3 / n mean_theta (theta . x_r - t_r) theta. Every part of the target is taken by as many
    particles as its mass asks for, however far they are: nothing is matched to the nearest.

    Args:
        target: Target points [dx], shape [m, 3].
        x: Particle positions [dx], device array, shape [n, 3]; of which `value` tells.
        directions: Lines to a step.
    """

    def __init__(self, target: Points, x: Any, directions: int) -> None:
        self._target = target
        self._x = x
        self._directions = directions
        self._edges = np.linspace(0, len(target), x.shape[0] + 1)
        self.turn(np.random.default_rng(0))

    def turn(self, rng: np.random.Generator) -> None:
        """Choose other lines."""
        theta = rng.normal(size=(self._directions, DIMENSIONS))
        self._theta = theta / np.linalg.norm(theta, axis=1, keepdims=True)
        self._goals = self._means(np.sort(self._target @ self._theta.T, axis=0))

    def value(self) -> float:
        """The loss over the lines as they are [dx^2], without the scatter of each part."""
        lags = self._lags(self._x.to_numpy().astype(np.float64))
        return float(0.5 * DIMENSIONS * np.mean(lags**2))

    def gradient(self, x: Any, gradient: Any) -> None:
        """Set `gradient` [n, 3] to that at particles x [dx], shape [n, 3], device arrays."""
        positions = x.to_numpy().astype(np.float64)
        pull = self._lags(positions) @ self._theta
        pull *= DIMENSIONS / (len(positions) * self._directions)
        gradient.from_numpy(pull.astype(backend.active().numpy_real))

    def _lags(self, positions: Points) -> Points:
        """theta . x_p - t of each particle and line [dx], shape [n, directions]."""
        projected = positions @ self._theta.T
        order = np.argsort(projected, axis=0)
        goals = np.empty_like(projected)
        np.put_along_axis(goals, order, self._goals, axis=0)
        return projected - goals

    def _means(self, sorted_target: Points) -> Points:
        """Means t_r of the parts of the sorted projections, shape [n, directions]."""
        integral = np.concatenate([np.zeros((1, self._directions)), np.cumsum(sorted_target, 0)])
        whole = np.minimum(self._edges.astype(int), len(sorted_target) - 1)
        rest = (self._edges - whole)[:, None]
        at_edges = integral[whole] + rest * sorted_target[whole]
        means: Points = np.diff(at_edges, axis=0) / np.diff(self._edges)[:, None]
        return means
