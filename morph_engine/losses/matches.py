"""Nearest neighbours between particles and target points, in both directions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.geometry.neighbor_index import NeighborIndex


class Matches:
    """Nearest neighbours of both directions, kept on the device.

    Args:
        target: Target points [dx], device array, shape [m, 3].
        x: Particle positions [dx], device array, shape [n, 3].
    """

    def __init__(self, target: Any, x: Any) -> None:
        device = backend.active()
        n, m = x.shape[0], target.shape[0]
        self.target = target
        self._target_index = NeighborIndex(target)
        self._particle_index = NeighborIndex(x)
        self.forward: Any = device.integers(n)
        self.forward_distance: Any = device.scalars(n)
        self.reverse: Any = device.integers(m)
        self.reverse_distance: Any = device.scalars(m)

    def update(self, x: Any) -> None:
        """Match particles at x and target points anew; the last matches speed up the search."""
        self._target_index.nearest(x, self.forward, self.forward_distance, self.forward)
        self._particle_index.update(x)
        self._particle_index.nearest(self.target, self.reverse, self.reverse_distance, self.reverse)

    def rebuild(self, x: Any) -> None:
        """Sort the particles anew, after they moved far."""
        self._particle_index.rebuild(x)

    def distances(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distances particle -> target, shape [n], and target -> particle, shape [m] [dx]."""
        return (
            self.forward_distance.to_numpy().astype(np.float64),
            self.reverse_distance.to_numpy().astype(np.float64),
        )
