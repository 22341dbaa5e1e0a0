"""What a planar result is measured by (algorithm 9 and 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Points = npt.NDArray[np.float64]

COVERAGE_RADIUS = 0.05
"""A target point closer than this to a source point is covered, as in the paper."""

CLUSTER_RADIUS = 0.02
"""The paper's: a source point closer than this to another one is clustered. In an ideal
result all points are clustered in this sense: 600 spread evenly over the star lie .0135 apart."""

TIGHT_CLUSTER_RADIUS = 0.005
"""The same question at a distance which an even spread stays clear of."""


@dataclass(frozen=True)
class PlanarMetrics:
    """Numbers of one point set against the target.

    Attributes:
        cd: sqrt(mean_i d_i^2 + mean_j d_j^2), the two-sided Chamfer distance, a length.
        coverage: Share of target points covered, 0 to 1.
        cluster_02: Share of source points with another closer than .02.
        cluster_005: Share of source points with another closer than .005.
        targets_used: Share of target points that are the nearest one of some source point.
        crowded: Share of source points whose nearest target is that of two or more others, too.
        unevenness: Standard deviation over mean of the number of points per target, each counted
            at its nearest; 0 for an even spread. Of all these it alone knows collapse from success.
    """

    cd: float
    coverage: float
    cluster_02: float
    cluster_005: float
    targets_used: float
    crowded: float
    unevenness: float


def measure(source: Points, target: Points) -> PlanarMetrics:
    """Measure a result.

    Args:
        source: Shape [n, 2], float64, n >= 2.
        target: Shape [m, 2], float64.
    """
    tree = cKDTree(source)
    forward, owner = cKDTree(target).query(source)
    reverse = tree.query(target)[0]
    served = np.bincount(owner, minlength=len(target))
    other = tree.query(source, 2)[0][:, 1]
    return PlanarMetrics(
        cd=float(np.sqrt(np.mean(forward**2) + np.mean(reverse**2))),
        coverage=float(np.mean(reverse < COVERAGE_RADIUS)),
        cluster_02=float(np.mean(other < CLUSTER_RADIUS)),
        cluster_005=float(np.mean(other < TIGHT_CLUSTER_RADIUS)),
        targets_used=float(np.mean(served > 0)),
        crowded=float(np.mean(served[owner] >= 3)),
        unevenness=float(np.std(served) / np.mean(served)),
    )
