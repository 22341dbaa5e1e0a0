"""Half the sum of both mean squared distances, each point with a weight (algorithm 8.2, 8.3)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from morph_engine.losses.k_nearest_neighbors import k_nearest_neighbors
from morph_engine.losses.matches import Matches
from morph_engine.losses.pair_loss import PairLoss

SMALLEST_DISTANCE = 1e-8  # added to the mean distance to neighbours, which may be 0 [dx]


class WeightedChamfer(PairLoss):
    """L = 1/2 [mean_p omega(p) d_fwd(p)^2 + mean_j omega(j) d_rev(j)^2].

    All weights are 1 until `weigh` sets them; they are constants of the derivative.
    """

    def __init__(self, matches: Matches) -> None:
        super().__init__(matches)
        self.weigh(np.ones(matches.forward.shape[0]), np.ones(matches.reverse.shape[0]))

    def weigh(self, particles: NDArray[Any], targets: NDArray[Any]) -> None:
        """Set omega of the particles, shape [n], and of the target points, shape [m]."""
        self._weights = particles, targets
        self._set_strengths(particles / len(particles), targets / len(targets))

    def value(self) -> float:
        """The loss at the matches as they are [dx^2]."""
        pairs = zip(self._weights, self.matches.distances(), strict=True)
        return float(0.5 * sum(np.mean(weight * d**2) for weight, d in pairs))

    def gradient(self, x: Any, gradient: Any) -> None:
        """Set `gradient` [n, 3] to that at particles x [dx], shape [n, 3], matched last."""
        self._pull(x, gradient)


def density_weights(
    points: NDArray[Any], neighbors: int, weighting: Literal["published", "inverse"]
) -> NDArray[np.float64]:
    """Weights by the mean distance r to the nearest points of the same set (algorithm 8.3).

    Args:
        points: Positions [dx], shape [n, 3].
        neighbors: How many nearest points, the point itself left out; at most n - 1 are used.
        weighting: "published" is 1 / r, which grows with density; "inverse" is r, which falls.

    Returns:
        Positive weights that sum to n, shape [n].
    """
    _, distance = k_nearest_neighbors(points, neighbors)
    mean = distance.mean(axis=1) + SMALLEST_DISTANCE
    weight = 1 / mean if weighting == "published" else mean
    return np.asarray(weight * (len(points) / weight.sum()))
