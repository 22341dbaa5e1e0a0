"""Line search: ever smaller trial steps until one lowers the objective (algorithm 6.2)."""

from __future__ import annotations

from collections.abc import Callable


def backtrack(
    trial: Callable[[float], float], objective: float, *, trials: int, factor: float
) -> bool:
    """Try steps until one lowers the objective; whether the one made last does.

    Args:
        trial: Makes a trial step of this share of the first one and returns its objective, NaN
            where the step is not acceptable.
        objective: What a step has to lower.
        trials: Steps to try at most.
        factor: By what each step is smaller than the one before.
    """
    return any(trial(factor**number) < objective for number in range(trials))
