"""How a gradient becomes a step: clipping, plain descent, Adam."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.config import PlanarConfig

Array = npt.NDArray[np.float64]

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam."""


def clip(gradient: Array, percentile: float) -> Array:
    """Cut vectors that are longer than a percentile (0 to 100) of all down to it, shape [n, d]."""
    length: Array = np.linalg.norm(gradient, axis=1, keepdims=True)
    limit = np.percentile(length, percentile)
    scale: Array = np.divide(limit, length, out=np.ones_like(length), where=length > limit)
    return gradient * scale


class Optimizer:
    """The optimizer of a configuration; call it with a gradient for the step to subtract."""

    def __init__(self, config: PlanarConfig) -> None:
        self._config = config
        self._count = 0
        self._mean: Array | float = 0.0
        self._square: Array | float = 0.0

    def __call__(self, gradient: Array) -> Array:
        """What to subtract from the variables, in the gradient's shape."""
        config = self._config
        rate = config.learning_rate
        if config.decay == "cosine":
            rate *= (1 + math.cos(math.pi * self._count / config.steps)) / 2
        self._count += 1
        if config.optimizer == "gradient_descent":
            return rate * gradient
        self._mean = BETA1 * self._mean + (1 - BETA1) * gradient
        self._square = BETA2 * self._square + (1 - BETA2) * gradient**2
        mean = self._mean / (1 - BETA1**self._count)
        square = self._square / (1 - BETA2**self._count)
        return rate * mean / (np.sqrt(square) + EPSILON)
