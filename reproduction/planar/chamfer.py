"""The Chamfer loss between two small point sets in any dimension, with its exact gradient.

    L = w_f / N sum_i d(p_i, NN_T(p_i)) + w_r / M sum_j d(q_j, NN_S(q_j)),   d = |.|^2 or |.|

This is the paper's loss (its appendix on the propositions, and algorithm 10). Within a fixed
assignment of nearest neighbours the gradient is exact; at a tie one of the nearest is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class ChamferLoss:
    """The loss with its weights and form.

    Attributes:
        forward: w_f, weight of source -> target.
        reverse: w_r, weight of target -> source.
        squared: Whether d is the squared distance.
        normalization: Divide each sum by its number of points, or not at all.
    """

    forward: float = 1.0
    reverse: float = 1.0
    squared: bool = True
    normalization: Literal["mean", "sum"] = "mean"

    def __call__(self, source: Points, target: Points) -> tuple[float, Points]:
        """Loss and its gradient with respect to the source.

        Args:
            source: p, shape [n, d], float64.
            target: q, shape [m, d], float64.

        Returns:
            L and dL/dp, shape [n, d].
        """
        forward, reverse = self.forward, self.reverse
        if self.normalization == "mean":
            forward, reverse = forward / len(source), reverse / len(target)
        gradient = np.zeros_like(source)

        away = source - target[nearest(source, target)]
        value, slope = self._distance(away)
        loss = forward * value
        gradient += forward * slope

        owner = nearest(target, source)
        value, slope = self._distance(source[owner] - target)
        loss += reverse * value
        np.add.at(gradient, owner, reverse * slope)
        return loss, gradient

    def _distance(self, away: Points) -> tuple[float, Points]:
        """Sum of d over the difference vectors, and its gradient by each of them."""
        if self.squared:
            return float(np.sum(away**2)), 2 * away
        length = np.linalg.norm(away, axis=1, keepdims=True)
        unit = np.divide(away, length, out=np.zeros_like(away), where=length > 0)
        return float(length.sum()), unit


def nearest(queries: Points, points: Points) -> Indices:
    """Index into ``points`` of the one nearest to each query: one index even at ties, shape [n]."""
    index: Indices = cKDTree(points).query(queries)[1]
    return index
