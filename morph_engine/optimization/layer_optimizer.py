"""Update rule for the control: AMSGrad on normalised gradients, with caps (algorithm 6.3)."""

from typing import Any

import numpy as np
import taichi as ti

from morph_engine import backend
from morph_engine.backend import CPU_CHUNK_STRIDE
from morph_engine.sections import OptimizerConfig

NORM_CHUNKS = 16

LARGEST_STEP = (5e-3, 5e-2)  # absolute, and relative to max(1, |U|), per particle
STATIONARY_STEP = (1e-4, 1e-3)  # below this the update is damped
STATIONARY_DAMPING = 0.2


UpdateArrays: Any = ti.types.argpack(
    **dict.fromkeys(("control", "first", "second", "largest"), ti.types.ndarray()),
    **dict.fromkeys(("control_new", "first_new", "second_new", "largest_new"), ti.types.ndarray()),
)
"""Control and moments of a layer, as committed and as tried."""


class Norm:
    """Frobenius norm of matrices on the device, summed in a fixed order."""

    def __init__(self) -> None:
        self._sums = backend.active().scalars(NORM_CHUNKS)

    def __call__(self, matrices: Any) -> float:
        """The norm over all entries of all matrices, shape [n, 3, 3]."""
        _square_sums(matrices, self._sums)
        return float(np.sqrt(self._sums.to_numpy().sum(dtype=np.float64)))


class LayerOptimizer:
    """Control of one layer and its moments, committed and on trial."""

    def __init__(self, particle_count: int, config: OptimizerConfig) -> None:
        device = backend.active()
        self._config = config
        states = [[device.matrices(particle_count) for _ in range(4)] for _ in range(2)]
        self._states, self._committed = states, 0
        self._updates = [UpdateArrays(*a, *b) for a, b in (states, reversed(states))]

    @property
    def kept(self) -> Any:
        """The committed control U, shape [n, 3, 3]."""
        return self._states[self._committed][0]

    def reset(self) -> None:
        """Zero control and moments, as at the start of a frame."""
        for array in self._states[self._committed]:
            _clear(array)

    def try_step(self, gradient: Any, norm: float, step: float, count: int) -> Any:
        """A trial control, shape [n, 3, 3], by a step along the control gradient over its norm.

        `count` is the 1-based number of this update, for the bias corrections.
        """
        c = self._config
        _adam(
            gradient, self._updates[self._committed], 1.0 / norm, step, c.beta1, c.beta2, c.epsilon,
            1.0 / (1.0 - c.beta1**count), 1.0 / (1.0 - c.beta2**count),
        )  # fmt: skip
        return self._states[1 - self._committed][0]

    def accept(self) -> None:
        """Commit the trial."""
        self._committed = 1 - self._committed


@ti.kernel
def _square_sums(matrices: ti.types.ndarray(), sums: ti.types.ndarray()):
    chunk = (matrices.shape[0] + NORM_CHUNKS - 1) // NORM_CHUNKS
    for task in range(NORM_CHUNKS * CPU_CHUNK_STRIDE):
        if task % CPU_CHUNK_STRIDE == 0:
            lane = task // CPU_CHUNK_STRIDE
            total = 0.0
            for p in range(lane * chunk, ti.min((lane + 1) * chunk, matrices.shape[0])):
                total += matrices[p].norm_sqr()
            sums[lane] = total


@ti.kernel
def _clear(matrices: ti.types.ndarray()):
    for p in range(matrices.shape[0]):
        matrices[p] = ti.Matrix.zero(float, 3, 3)


@ti.kernel
def _adam(
    gradient: ti.types.ndarray(),
    update: UpdateArrays,
    scale: float,
    step: float,
    beta1: float,
    beta2: float,
    epsilon: float,
    correction1: float,
    correction2: float,
):
    for p in range(gradient.shape[0]):
        g = gradient[p] * scale
        m = beta1 * update.first[p] + (1 - beta1) * g
        a = beta2 * update.second[p] + (1 - beta2) * (g * g)
        u = ti.max(update.largest[p], a * correction2)
        direction = (m * correction1) / (ti.max(ti.sqrt(u), 1e-8) + epsilon)
        old = update.control[p]
        size = ti.max(1.0, old.norm())
        length = step * direction.norm()
        cap = ti.max(LARGEST_STEP[0], LARGEST_STEP[1] * size)
        change = step * direction
        if length > cap:
            change *= cap / length
        if length <= ti.max(STATIONARY_STEP[0], STATIONARY_STEP[1] * size):
            change *= STATIONARY_DAMPING
        update.control_new[p] = old - change
        update.first_new[p] = m
        update.second_new[p] = a
        update.largest_new[p] = u
