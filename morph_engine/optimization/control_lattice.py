"""Displacements of all particles by a few control points: cubic B-splines on a lattice."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix


class ControlLattice:
    """u(X) = sum_c B_c(X) u_c with cubic B-splines B_c over the bounding box of some points.

    Each point depends on 64 control points, whose weights sum to 1 (algorithm 8.6).

    Args:
        points: Positions X [dx], shape [n, 3].
        cells: Cells of the lattice along the longest side of the bounding box.
        dtype: Type of the weights.

    Attributes:
        count: Number of control points.
    """

    def __init__(self, points: NDArray[Any], cells: int, dtype: type[np.floating[Any]]) -> None:
        lower, extent = points.min(axis=0).astype(np.float64), np.ptp(points.astype(float), axis=0)
        spacing = float(extent.max()) / cells or 1.0
        shape = np.maximum(np.ceil(extent / spacing - 1e-6), 1).astype(int)
        place = (points - lower) / spacing
        cell = np.clip(np.floor(place).astype(int), 0, shape - 1)
        values = _splines(place - cell)  # [n, 3, 4]
        weights = np.einsum("ni,nj,nk->nijk", values[:, 0], values[:, 1], values[:, 2])
        nodes = shape + 3
        along = [cell[:, axis, None] + np.arange(4) for axis in range(3)]
        x, y, z = along[0][:, :, None, None], along[1][:, None, :, None], along[2][:, None, None]
        index = ((x * nodes[1] + y) * nodes[2] + z).astype(np.int32)
        n = len(points)
        self.count: int = int(nodes.prod())
        self._weights = csr_matrix(
            (weights.reshape(-1).astype(dtype), index.reshape(-1), np.arange(0, 64 * n + 1, 64)),
            shape=(n, self.count),
        )

    def displacements(self, control: NDArray[Any]) -> NDArray[Any]:
        """Displacement of every point, shape [n, 3], by those of the control points, [count, 3]."""
        return np.asarray(self._weights @ control)

    def gradient(self, gradient: NDArray[Any]) -> NDArray[Any]:
        """By the control points, shape [count, 3], from that by the points, shape [n, 3]."""
        return np.asarray(self._weights.T @ gradient)


def _splines(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """The four cubic B-splines at t in [0, 1] of a cell; a new last axis holds them."""
    pieces = (
        (1 - t) ** 3,
        3 * t**3 - 6 * t**2 + 4,
        -3 * t**3 + 3 * t**2 + 3 * t + 1,
        t**3,
    )
    return np.stack(pieces, axis=-1) / 6
