"""The Chamfer loss between two small point sets in any dimension, with its exact gradient.

    L = w_f / N sum_i |p_i - NN_T(p_i)|^2 + w_r / M sum_j |q_j - NN_S(q_j)|^2

This is the paper's loss (its appendix on the propositions, and algorithm 10). Within a fixed
assignment of nearest neighbours the gradient is exact; at a tie one of the nearest is taken.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


def chamfer_loss(
    source: Points, target: Points, *, forward: float = 1.0, reverse: float = 1.0
) -> tuple[float, Points]:
    """Loss and its gradient with respect to the source.

    Args:
        source: p, shape [n, d], float64.
        target: q, shape [m, d], float64.
        forward: w_f, weight of source -> target.
        reverse: w_r, weight of target -> source.

    Returns:
        L and dL/dp, shape [n, d].
    """
    forward, reverse = forward / len(source), reverse / len(target)
    owner = nearest(target, source)
    there = source - target[nearest(source, target)]
    back = source[owner] - target
    gradient = 2 * forward * there
    np.add.at(gradient, owner, 2 * reverse * back)
    return float(forward * np.sum(there**2) + reverse * np.sum(back**2)), gradient


def nearest(queries: Points, points: Points) -> Indices:
    """Index into ``points`` of the one nearest to each query: one index even at ties, shape [n]."""
    index: Indices = cKDTree(points).query(queries)[1]
    return index
