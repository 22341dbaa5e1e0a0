"""The curve of all that begins and ends at rest: motion, playing time and colours."""

from __future__ import annotations


def smoothstep(share: float) -> float:
    """From 0 to 1, without speed at either end: 3 t^2 - 2 t^3; constant before 0 and after 1."""
    t = min(max(share, 0.0), 1.0)
    return t * t * (3 - 2 * t)
