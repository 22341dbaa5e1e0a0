"""The density-aware Chamfer distance of Wu et al., NeurIPS 2021 (arXiv 2111.12702)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from morph_engine.losses.matches import Matches
from morph_engine.losses.pair_loss import PairLoss


class DensityAwareChamfer(PairLoss):
    """Each match counts exp(-alpha d), divided among all that chose the same point.

    With n_q the number of particles whose nearest target point is q, and n_x that of target points
    whose nearest particle is x, and alpha [1 / dx]::

        L = 1/2 [ mean_p (1 - c_S / n_q(p) exp(-alpha d_fwd(p)))
                + mean_j (1 - c_T / n_x(j) exp(-alpha d_rev(j))) ]

    c_S = max(1, N / M) and c_T = max(1, M / N) are the counts that an even match would have; both
    are 1 for sets of equal size. Counts are constants of the derivative, and a pair at distance 0
    has the derivative 0 (algorithm 8.5).
    """

    def __init__(self, matches: Matches, alpha: float) -> None:
        super().__init__(matches)
        self._alpha = alpha

    def value(self) -> float:
        """The loss at the matches as they are; at most 1."""
        d_fwd, d_rev = self.matches.distances()
        to_target, to_particle = self._shares()
        decay_fwd, decay_rev = np.exp(-self._alpha * d_fwd), np.exp(-self._alpha * d_rev)
        return float(1 - 0.5 * (np.mean(to_target * decay_fwd) + np.mean(to_particle * decay_rev)))

    def gradient(self, x: Any, gradient: Any) -> None:
        """Set `gradient` [n, 3] to that at particles x [dx], shape [n, 3], matched last."""
        forward, reverse = (
            self._slope(distance) * share / len(share)
            for distance, share in zip(self.matches.distances(), self._shares(), strict=True)
        )
        self._set_strengths(forward, reverse)
        self._pull(x, gradient)

    def _slope(self, distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivative of -exp(-alpha d) / 2 by d, divided by d."""
        slope = 0.5 * self._alpha * np.exp(-self._alpha * distance)
        return np.divide(slope, distance, out=np.zeros_like(slope), where=distance > 0)

    def _shares(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """c / n of every match, per particle [n] and per target point [m]."""
        forward, reverse = self.matches.forward.to_numpy(), self.matches.reverse.to_numpy()
        n, m = len(forward), len(reverse)
        return _share(forward, m) * max(1.0, n / m), _share(reverse, n) * max(1.0, m / n)


def _share(match: NDArray[np.int32], choices: int) -> NDArray[np.float64]:
    """One over the number of those with the same match; 0 without a match (-1)."""
    found = match >= 0
    count = np.bincount(match[found], minlength=choices)
    return np.where(found, 1 / np.maximum(count[match], 1), 0.0)
