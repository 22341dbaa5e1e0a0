"""What a method returns is looked at before it is measured and stored."""

from __future__ import annotations

from typing import Any

import numpy as np

from morph_engine.errors import SimulationError
from morph_engine.methods.method import FrameOutcome, Method


def check_outcome(outcome: FrameOutcome, method: Method[Any], frame: int) -> None:
    """Refuse an outcome that is not as `FrameOutcome` describes.

    Raises:
        SimulationError: An array has another shape, or an index is none of a target point.
    """
    if not isinstance(outcome, FrameOutcome):
        raise _refused(method, frame, f"a {type(outcome).__name__}, not a FrameOutcome")
    particles, targets = len(method.problem.source), len(method.problem.target)
    shapes = {
        "positions": (particles, 3),
        "d_fwd": (particles,),
        "nearest_fwd": (particles,),
        "d_rev": (targets,),
        "gap": (particles,),
        "deformation": (particles, 3, 3),
    }
    for name, shape in shapes.items():
        array = getattr(outcome, name)
        if array is None and name in ("gap", "deformation"):
            continue
        if np.shape(array) != shape:
            raise _refused(method, frame, f"{name} of shape {np.shape(array)}, not {shape}")
    known = np.asarray(outcome.nearest_fwd)[np.isfinite(outcome.d_fwd)]
    if len(known) and not (0 <= known.min() and known.max() < targets):
        raise _refused(method, frame, "an index in nearest_fwd that is none of a target point")


def _refused(method: Method[Any], frame: int, what: str) -> SimulationError:
    cause = f"the method {method.name!r} returned {what}"
    return SimulationError.after(frame, cause, "let it return what FrameOutcome describes")
