"""Bidirectional Chamfer loss between particles and target points (algorithm 5)."""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.losses.cell_search import restrict_to_cells
from morph_engine.losses.gaussian_smoothing import GaussianSmoothing
from morph_engine.losses.matches import Matches
from morph_engine.mpm.grid import Grid
from morph_engine.sections import ChamferConfig

SMALLEST_GRADIENT = 1e-10  # a particle with a larger reverse gradient counts as active


class ChamferLoss:
    """L = mean_p l(d_fwd) + w_rev mean_j l(d_rev), l squared or Huber (algorithm 5.1)."""

    def __init__(self, matches: Matches, config: ChamferConfig, grid: Grid) -> None:
        self.matches = matches
        self.config = config
        self._grid = grid
        self._reverse = backend.active().vectors(matches.forward.shape[0])
        self._average = (
            GaussianSmoothing(grid, config.reverse_smoothing)
            if config.reverse_smoothing > 0
            else None
        )

    def evaluate(self, x: Any, reverse_weight: float) -> float:
        """The loss of particles at x [dx], shape [n, 3]; w_rev = `reverse_weight`."""
        self.matches.update(x)
        forward, reverse = self.matches.distances()
        if self.config.neighborhood == "published":
            forward, reverse = restrict_to_cells(self.matches, x, forward, reverse, self._grid)
        return self._mean_loss(forward) + reverse_weight * self._mean_loss(reverse)

    def add_gradient(self, x: Any, x_bar: Any, weight: float, reverse_weight: float) -> None:
        """Add weight * (g_fwd + reverse_weight * g_rev) at the x evaluated last to x_bar."""
        delta, m = self.config.huber_delta, self.matches
        _add_forward(x, m.target, m.forward, x_bar, delta, weight)
        if reverse_weight == 0:
            return
        device = backend.active()
        lanes = 1 if device.on_cpu else m.target.shape[0]
        _gather_reverse(x, m.target, m.reverse, self._reverse, delta, lanes, not device.on_cpu)
        limit = self._clamp_limit()
        if limit > 0:
            _clamp(self._reverse, limit)
        if self._average is not None:
            self._average.apply(x, self._reverse)
        _add(self._reverse, x_bar, weight * reverse_weight)

    def _mean_loss(self, distance: NDArray[np.float64]) -> float:
        """Mean of l_delta(d); points without a match (d infinite) count with 0."""
        delta = self.config.huber_delta
        d = np.where(np.isfinite(distance), distance, 0.0)
        loss = d * d if delta == 0 else np.where(d < delta, d * d, delta * (2 * d - delta))
        return float(loss.mean())

    def _clamp_limit(self) -> float:
        """kappa times the mean length of the active reverse gradients (algorithm 5.3)."""
        if self.config.reverse_clamp == 0:
            return 0.0
        length = np.linalg.norm(self._reverse.to_numpy().astype(np.float64), axis=1)
        active = length[length > SMALLEST_GRADIENT]
        return float(self.config.reverse_clamp * active.mean()) if len(active) else 0.0


@ti.func
def _slope(difference, delta: float):
    """Gradient of l_delta(|difference|) by the particle's position (algorithm 5.2)."""
    distance = difference.norm()
    result = 2 * difference
    if delta > 0 and distance >= delta:
        result = (2 * delta / distance) * difference
    return result


@ti.kernel
def _add_forward(
    x: ti.types.ndarray(),
    target: ti.types.ndarray(),
    match: ti.types.ndarray(),
    x_bar: ti.types.ndarray(),
    delta: float,
    weight: float,
):
    for p in range(x.shape[0]):
        if match[p] >= 0:
            x_bar[p] += (weight / x.shape[0]) * _slope(x[p] - target[match[p]], delta)


@ti.kernel
def _gather_reverse(
    x: ti.types.ndarray(),
    target: ti.types.ndarray(),
    match: ti.types.ndarray(),
    result: ti.types.ndarray(),
    delta: float,
    lanes: int,
    atomic: ti.template(),
):
    """Each target point's pull on its matched particle; on the CPU in target order."""
    for p in range(result.shape[0]):
        result[p] = ti.Vector.zero(float, 3)
    chunk = (target.shape[0] + lanes - 1) // lanes
    for lane in range(lanes):
        for j in range(lane * chunk, ti.min((lane + 1) * chunk, target.shape[0])):
            p = match[j]
            if p >= 0:
                pull = _slope(x[p] - target[j], delta) / target.shape[0]
                if ti.static(atomic):
                    ti.atomic_add(result[p], pull)
                else:
                    result[p] = result[p] + pull


@ti.kernel
def _clamp(vectors: ti.types.ndarray(), limit: float):
    for p in range(vectors.shape[0]):
        length = vectors[p].norm()
        if length > limit:
            vectors[p] = vectors[p] * (limit / length)


@ti.kernel
def _add(vectors: ti.types.ndarray(), result: ti.types.ndarray(), weight: float):
    for p in range(vectors.shape[0]):
        result[p] += weight * vectors[p]
