"""A peer that computes something else is not a peer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scene import Layer

Array = NDArray[np.floating[Any]]

# float32 rounding of 64-node sums whose stress terms largely cancel; measured 3e-6.
TOLERANCE = 3e-5
# Gradients go through several such sums; measured 1e-5.
GRADIENT_TOLERANCE = 1e-4


def require_agreement(name: str, layer: Layer, reference: Layer) -> None:
    """Raise AssertionError unless every array equals the reference's to float32 rounding."""
    for field in fields(Layer):
        error = relative_error(getattr(layer, field.name), getattr(reference, field.name))
        if not error < TOLERANCE:
            raise AssertionError(f"{name} disagrees in {field.name}: relative error {error:.1e}")


def require_equal_gradients(name: str, ours: Sequence[Array], theirs: Sequence[Array]) -> None:
    """Raise AssertionError unless the control gradients of all layers are equal."""
    for layer, (mine, other) in enumerate(zip(ours, theirs, strict=True)):
        error = relative_error(mine, other)
        if not error < GRADIENT_TOLERANCE:
            raise AssertionError(
                f"{name} disagrees in the control gradient of layer {layer}: "
                f"relative error {error:.1e}"
            )


def relative_error(values: Array, reference: Array) -> float:
    """Largest difference over the largest magnitude of the reference."""
    return float(np.abs(values - reference).max() / np.abs(reference).max())
