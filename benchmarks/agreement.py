"""A peer that computes something else is not a peer."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from benchmarks.scene import Layer

# float32 rounding of 64-node sums whose stress terms largely cancel; measured 3e-6.
TOLERANCE = 3e-5


def require_agreement(name: str, layer: Layer, reference: Layer) -> None:
    """Raise AssertionError unless every array equals the float64 reference to float32 rounding.

    The error of an array is its largest difference over the largest magnitude in the reference.
    """
    for field in fields(Layer):
        ours, theirs = getattr(layer, field.name), getattr(reference, field.name)
        error = np.abs(ours - theirs).max() / np.abs(theirs).max()
        if not error < TOLERANCE:
            raise AssertionError(f"{name} disagrees in {field.name}: relative error {error:.1e}")
