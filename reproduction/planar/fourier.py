"""A closed outline that all points share: a Fourier series of its radius (algorithm 10)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.shapes import directions

Array = npt.NDArray[np.float64]

MODES = 12
"""K; an outline has 2 K + 1 coefficients."""


class FourierOutline:
    """Points at fixed angles on r(theta) = a_0 + sum_k (a_k cos k theta + b_k sin k theta).

    Args:
        angles: theta of each point [radians], shape [n], float64.
    """

    def __init__(self, angles: Array) -> None:
        phase = angles[:, None] * np.arange(1, MODES + 1)
        self._basis = np.hstack([np.ones((len(angles), 1)), np.cos(phase), np.sin(phase)])
        self._directions = directions(angles)

    def circle(self, radius: float) -> Array:
        """Coefficients of a circle: (a_0, a_1..a_K, b_1..b_K), shape [2 K + 1]."""
        coefficients = np.zeros(2 * MODES + 1)
        coefficients[0] = radius
        return coefficients

    def points(self, coefficients: Array) -> Array:
        """Where the points are, shape [n, 2]."""
        return (self._basis @ coefficients)[:, None] * self._directions

    def pull_back(self, gradient: Array) -> Array:
        """Gradient by the coefficients, shape [2 K + 1], from that by the points, [n, 2]."""
        slope: Array = self._basis.T @ np.sum(gradient * self._directions, axis=1)
        return slope
