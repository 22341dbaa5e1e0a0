"""Adam with the AMSGrad maximum, as PyTorch defines it (algorithm 8.2)."""

import math
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend


class AMSGrad:
    """Moments of vector variables, and the step they make.

    With the gradient g of step t = 1, 2, ... and the learning rate lr [dx]::

        m = beta1 m + (1 - beta1) g          a = beta2 a + (1 - beta2) g^2          u = max(u, a)
        x = x - lr / (1 - beta1^t) * m / (sqrt(u) / sqrt(1 - beta2^t) + epsilon)

    The maximum is taken before the bias correction. Where sqrt(u) is far below epsilon this is
    plain gradient descent with momentum at the rate lr / epsilon.
    """

    def __init__(
        self, count: int, *, learning_rate: float, beta1: float, beta2: float, epsilon: float
    ) -> None:
        device = backend.active()
        self._learning_rate = learning_rate
        self._beta1, self._beta2 = beta1, beta2
        self._epsilon = epsilon
        self._moments = {name: device.vectors(count) for name in ("first", "second", "largest")}
        self._steps = 0

    def step(self, values: Any, gradient: Any) -> None:
        """Move the values [dx] in place by their gradient, device arrays of shape [count, 3]."""
        self._steps += 1
        _step(
            values,
            gradient,
            *self._moments.values(),
            self._beta1,
            self._beta2,
            self._learning_rate / (1 - self._beta1**self._steps),
            1 / math.sqrt(1 - self._beta2**self._steps),
            self._epsilon,
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """Moments, shape [count, 3], and the number of steps made."""
        moments = {name: array.to_numpy() for name, array in self._moments.items()}
        return {**moments, "steps": np.array(self._steps)}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up a state that `state` returned; other entries are left alone."""
        for name, array in self._moments.items():
            array.from_numpy(state[name])
        self._steps = int(state["steps"])


@ti.kernel
def _step(
    values: ti.types.ndarray(),
    gradient: ti.types.ndarray(),
    first: ti.types.ndarray(),
    second: ti.types.ndarray(),
    largest: ti.types.ndarray(),
    beta1: float,
    beta2: float,
    rate: float,
    correction: float,
    epsilon: float,
):
    for i in range(values.shape[0]):
        g = gradient[i]
        m = beta1 * first[i] + (1 - beta1) * g
        a = beta2 * second[i] + (1 - beta2) * (g * g)
        u = ti.max(largest[i], a)
        values[i] = values[i] - rate * m / (ti.sqrt(u) * correction + epsilon)
        first[i] = m
        second[i] = a
        largest[i] = u
