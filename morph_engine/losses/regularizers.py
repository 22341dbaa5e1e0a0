"""Local regularizers of direct optimisation: repulsion, smoothness, volume (algorithm 8.4)."""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.losses.k_nearest_neighbors import k_nearest_neighbors
from morph_engine.sections import RegularizerConfig

SMALLEST_SQUARE = 1e-8  # repulsion stops growing below this squared distance [dx^2]


class Regularizers:
    """The weighted sum of three terms.

    ::

        R_rep = 1/(8 N) sum_p sum_{r in near8(p)} [|x_p - x_r| < theta] / max(|x_p - x_r|^2, 1e-8)
        R_sm  = 1/N sum_p |x_p - mean_{r in near12(p)} x_r|^2
        R_vol = (B(x) / B(x_0) - 1)^2          B: product of the extents along the axes

    Lists of neighbours, and theta = half the mean distance in the first 8, are those of the last
    `rebuild` and constants of the derivative.

    Args:
        source: Particle positions x_0 [dx], shape [n, 3].
        config: Weights and lengths of the lists.
    """

    def __init__(self, source: NDArray[Any], config: RegularizerConfig) -> None:
        device = backend.active()
        self._config = config
        self._count = len(source)
        self._width = min(config.neighbors, self._count - 1)
        self._near = min(config.repulsion_neighbors, self._width)
        self._needs_lists = config.repulsion > 0 or config.smoothness > 0
        entries = self._count * self._width if self._needs_lists else 1
        self._lists = device.integers(entries)
        self._incoming = device.integers(entries)
        self._first = device.integers(self._count + 1)
        self._offset = device.vectors(self._count)
        self._theta = 0.0
        self._volume = float(np.ptp(source.astype(np.float64), axis=0).prod())

    def rebuild(self, x: Any) -> None:
        """List the neighbours of every particle anew, at x [dx], shape [n, 3]."""
        if not self._needs_lists:
            return
        lists, distance = k_nearest_neighbors(x.to_numpy(), self._width)
        self._theta = 0.5 * float(distance[:, : self._near].mean())
        flat = lists.reshape(-1)
        ends = np.cumsum(np.bincount(flat, minlength=self._count))
        self._lists.from_numpy(flat.astype(np.int32))
        self._incoming.from_numpy(np.argsort(flat, kind="stable").astype(np.int32))
        self._first.from_numpy(np.concatenate(([0], ends)).astype(np.int32))

    def value(self, x: Any) -> float:
        """The weighted sum at particles x [dx], shape [n, 3]."""
        c, points = self._config, x.to_numpy().astype(np.float64)
        total = c.volume * self._growth(points) ** 2 if c.volume > 0 else 0.0
        if not self._needs_lists:
            return total
        neighbors = points[self._lists.to_numpy().reshape(self._count, self._width)]
        if c.repulsion > 0:
            square = np.sum((points[:, None] - neighbors[:, : self._near]) ** 2, axis=2)
            close = square < self._theta**2
            total += c.repulsion * float(np.mean(close / np.maximum(square, SMALLEST_SQUARE)))
        if c.smoothness > 0:
            offset = points - neighbors.mean(axis=1)
            total += c.smoothness * float(np.mean(np.sum(offset**2, axis=1)))
        return total

    def add_gradient(self, x: Any, gradient: Any) -> None:
        """Add the gradient of the sum at x [dx], shape [n, 3], to `gradient`, shape [n, 3]."""
        c, lists = self._config, (self._lists, self._incoming, self._first)
        if c.repulsion > 0:
            scale = c.repulsion / (self._near * self._count)
            _repel(x, *lists, gradient, self._width, self._near, self._theta**2, scale)
        if c.smoothness > 0:
            _offset(x, self._lists, self._offset, self._width)
            scale = 2 * c.smoothness / self._count
            _straighten(self._offset, *lists[1:], gradient, self._width, scale)
        if c.volume > 0:
            self._add_volume(x, gradient)

    def _growth(self, points: NDArray[np.float64]) -> float:
        """Relative growth of the bounding box."""
        return float(np.ptp(points, axis=0).prod()) / self._volume - 1

    def _add_volume(self, x: Any, gradient: Any) -> None:
        """The extreme particle of either end of each axis carries the gradient."""
        points = x.to_numpy().astype(np.float64)
        extent = np.ptp(points, axis=0)
        slope = 2 * self._config.volume * self._growth(points) / self._volume
        face = np.array([extent[1] * extent[2], extent[2] * extent[0], extent[0] * extent[1]])
        index = np.concatenate((points.argmax(axis=0), points.argmin(axis=0)))
        for end in range(6):
            sign = 1 if end < 3 else -1
            _add_at(gradient, int(index[end]), end % 3, sign * slope * float(face[end % 3]))


@ti.func
def _repulsion(difference, theta_squared: float):
    """Derivative of 1 / |difference|^2 by the difference, 0 beyond theta and on coincidence."""
    squared = difference.norm_sqr()
    result = ti.Vector.zero(float, 3)
    if SMALLEST_SQUARE < squared < theta_squared:
        result = (-2 / (squared * squared)) * difference
    return result


@ti.kernel
def _repel(
    x: ti.types.ndarray(),
    lists: ti.types.ndarray(),
    incoming: ti.types.ndarray(),
    first: ti.types.ndarray(),
    gradient: ti.types.ndarray(),
    width: int,
    near: int,
    theta_squared: float,
    scale: float,
):
    """Both ends of each pair are gathered by the particle itself: no atomics, a fixed order."""
    for p in range(x.shape[0]):
        total = ti.Vector.zero(float, 3)
        for entry in range(p * width, p * width + near):
            total += _repulsion(x[p] - x[lists[entry]], theta_squared)
        for k in range(first[p], first[p + 1]):
            if incoming[k] % width < near:
                total += _repulsion(x[p] - x[incoming[k] // width], theta_squared)
        gradient[p] += scale * total


@ti.kernel
def _offset(
    x: ti.types.ndarray(), lists: ti.types.ndarray(), offset: ti.types.ndarray(), width: int
):
    """From the mean of its neighbours to the particle."""
    for p in range(x.shape[0]):
        mean = ti.Vector.zero(float, 3)
        for entry in range(p * width, (p + 1) * width):
            mean += x[lists[entry]] / width
        offset[p] = x[p] - mean


@ti.kernel
def _straighten(
    offset: ti.types.ndarray(),
    incoming: ti.types.ndarray(),
    first: ti.types.ndarray(),
    gradient: ti.types.ndarray(),
    width: int,
    scale: float,
):
    """Gradient of half the squared offsets: through the particle, and through those it is near."""
    for p in range(offset.shape[0]):
        total = offset[p]
        for k in range(first[p], first[p + 1]):
            total -= offset[incoming[k] // width] / width
        gradient[p] += scale * total


@ti.kernel
def _add_at(vectors: ti.types.ndarray(), index: int, axis: int, amount: float):
    vectors[index][axis] += amount
