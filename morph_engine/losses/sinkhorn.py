"""Sinkhorn divergence on the grid: entropic optimal transport, made zero at equality.

Feydy et al., "Interpolating between optimal transport and MMD using Sinkhorn divergences", 2019;
kernels along one axis after the other as in Solomon et al., "Convolutional Wasserstein distances",
2015, here in logarithms.
"""

from typing import Any

import numpy as np
import taichi as ti

from morph_engine import backend
from morph_engine.losses.grid_mass import GridMass
from morph_engine.mpm.grid import Grid

START_ROUNDS = 100
NOTHING = -1e30
"""Logarithm of no mass."""


class SinkhornDivergence:
    """S(a, b) = OT(a, b) - OT(a, a) / 2 - OT(b, b) / 2 of two masses a and b on the grid.

    OT is entropic transport at the cost |x - y|^2 / 2 with the temperature blur^2. With its dual
    potentials f, g and the symmetric ones p, q of OT(a, a) and OT(b, b)::

        S = sum_i a_i (f_i - p_i) + sum_i b_i (g_i - q_i)        dS/da_i = f_i - p_i

    Both sets have the mass 1, spread to nodes by the B-splines of the simulation. Potentials are
    kept from step to step, and improved in some rounds of each.

    Args:
        target: Target points [dx], device array, shape [m, 3].
        x: Particle positions [dx], device array, shape [n, 3].
        grid: Background grid.
        blur: Length below which masses are not told apart [dx].
        rounds: Rounds in which potentials are improved before each gradient.
    """

    def __init__(self, target: Any, x: Any, *, grid: Grid, blur: float, rounds: int) -> None:
        device = backend.active()
        self._x, self._grid = x, grid
        self._temperature, self._rounds = blur**2, rounds
        self._particles = GridMass(x.shape[0], 1 / x.shape[0], grid)
        self._b = GridMass(target.shape[0], 1 / target.shape[0], grid).gather(target)
        count = grid.node_count
        self._f, self._g, self._p, self._q = (device.scalars(count) for _ in range(4))
        self._new, self._other, self._line, self._slope = (device.scalars(count) for _ in range(4))
        for _ in range(START_ROUNDS):
            self._improve(self._q, self._q, self._b)
        self._a = self._particles.gather(x)
        self._improve_all(START_ROUNDS)

    def value(self) -> float:
        """The divergence at the particles as they are [dx^2]."""
        self._a = self._particles.gather(self._x)
        self._improve_all(self._rounds)
        a, b, f, g, p, q = (
            array.to_numpy().astype(np.float64)
            for array in (self._a, self._b, self._f, self._g, self._p, self._q)
        )
        return float(a @ (f - p) + b @ (g - q))

    def gradient(self, x: Any, gradient: Any) -> None:
        """Set `gradient` [n, 3] to that at particles x [dx], shape [n, 3], device arrays."""
        self._a = self._particles.gather(x)
        self._improve_all(self._rounds)
        _difference(self._f, self._p, self._slope)
        self._particles.pull_back(x, self._slope, gradient)

    def state(self) -> dict[str, Any]:
        """Potentials, each of shape [node_count]."""
        return {"f": self._f.to_numpy(), "g": self._g.to_numpy(), "p": self._p.to_numpy()}

    def restore(self, state: dict[str, Any]) -> None:
        """Take up a state that `state` returned; other entries are left alone."""
        for name, array in (("f", self._f), ("g", self._g), ("p", self._p)):
            array.from_numpy(state[name])

    def _improve_all(self, rounds: int) -> None:
        for _ in range(rounds):
            self._softmin(self._g, self._b, self._new)
            self._softmin(self._f, self._a, self._other)
            _average(self._f, self._new)
            _average(self._g, self._other)
            self._improve(self._p, self._p, self._a)

    def _improve(self, potential: Any, other: Any, mass: Any) -> None:
        self._softmin(other, mass, self._new)
        _average(potential, self._new)

    def _softmin(self, potential: Any, mass: Any, result: Any) -> None:
        """-T log sum_j mass_j exp((potential_j - |x_i - x_j|^2 / 2) / T) for every node i."""
        n, dx = self._grid.resolution, self._grid.dx
        _weigh(potential, mass, result, self._temperature)
        curvature = 0.5 * dx * dx / self._temperature
        _log_sum(result, self._line, n, 1, curvature)
        _log_sum(self._line, result, n, n, curvature)
        _log_sum(result, self._line, n, n * n, curvature)
        _scale(self._line, result, -self._temperature)


@ti.kernel
def _weigh(
    potential: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    result: ti.types.ndarray(),
    temperature: float,
):
    for i in range(mass.shape[0]):
        result[i] = NOTHING
        if mass[i] > 0:
            result[i] = ti.log(mass[i]) + potential[i] / temperature


@ti.kernel
def _log_sum(
    values: ti.types.ndarray(),
    result: ti.types.ndarray(),
    nodes: int,
    stride: int,
    curvature: float,
):
    """log sum_j exp(value_j - curvature (i - j)^2) along the lines of one axis."""
    for i in range(values.shape[0]):
        place = (i // stride) % nodes
        first = i - place * stride
        largest = -ti.math.inf
        for j in range(nodes):
            apart = float(place - j)
            largest = ti.max(largest, values[first + j * stride] - curvature * apart * apart)
        total = 0.0
        for j in range(nodes):
            apart = float(place - j)
            total += ti.exp(values[first + j * stride] - curvature * apart * apart - largest)
        result[i] = largest + ti.log(total)


@ti.kernel
def _scale(values: ti.types.ndarray(), result: ti.types.ndarray(), factor: float):
    for i in range(values.shape[0]):
        result[i] = factor * values[i]


@ti.kernel
def _average(values: ti.types.ndarray(), others: ti.types.ndarray()):
    """Half way to the others: averaged updates do not oscillate."""
    for i in range(values.shape[0]):
        values[i] = 0.5 * (values[i] + others[i])


@ti.kernel
def _difference(a: ti.types.ndarray(), b: ti.types.ndarray(), result: ti.types.ndarray()):
    for i in range(a.shape[0]):
        result[i] = a[i] - b[i]
