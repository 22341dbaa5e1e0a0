"""Proposition 2: the reverse term moves at most one of several coincident points.

A target point has one nearest source point. Of k that share a place, the search returns one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.chamfer import nearest
from chamfer_morph.reproduction.planar.shapes import directions
from chamfer_morph.reproduction.propositions.check import Check, Limit, Quantity
from chamfer_morph.reproduction.propositions.collapse import STEPS, descend
from chamfer_morph.reproduction.propositions.scene import (
    CENTER,
    TARGETS,
    chamfer_gradient,
    reverse_gradient,
)

Points = npt.NDArray[np.float64]

COUNT = 12
"""k, the coincident points; there are no others, so that N = k."""


def proposition_2() -> Check:
    """Measure the gradients of k points at one target, and of k points almost there."""
    collapsed = np.tile(CENTER, (COUNT, 1))
    reverse = reverse_gradient(collapsed)
    both = chamfer_gradient(collapsed)
    rest = descend(collapsed, STEPS, chamfer_gradient)[-1]
    moved = np.linalg.norm(reverse, axis=1) > 0
    chosen = int(np.argmax(moved))
    formula = -2 / len(TARGETS) * (TARGETS - CENTER).sum(axis=0)
    return Check(
        name="Proposition 2",
        statement=(
            "Of k points collapsed at a target, the reverse term has a gradient for at most one; "
            "the other k - 1 have none from either term."
        ),
        quantities=(
            Quantity("points with a reverse gradient", float(moved.sum()), 1.0, "<="),
            Quantity(
                "deviation of that one's gradient from -2/M sum_j (q_j - q*)",
                float(abs(reverse[chosen] - formula).max()),
                0.0,
                tolerance=1e-15,
            ),
            Quantity(
                "largest gradient of the others from both terms",
                float(abs(np.delete(both, chosen, axis=0)).max()),
                0.0,
            ),
        ),
        limits=tuple(
            Limit(case, Quantity(name, float(count), 1.0, "<="))
            for case, name, count in (
                (
                    "The statement is about an instant. When the one point has moved off, targets "
                    "on the other side have their nearest source point among those left behind, "
                    "and pull a second one.",
                    f"points that have moved after {STEPS} steps of both terms",
                    (abs(rest - CENTER).max(axis=1) > 0.01).sum(),
                ),
                (
                    "Points that do not coincide to the last bit have cells of their own, however "
                    "close they are, and each that is nearest to some target has a reverse "
                    "gradient.",
                    "points with a reverse gradient, 1e-9 apart",
                    moving(apart(1e-9)).sum(),
                ),
                (
                    "Descent then takes them apart, so that collapse is no deadlock for points "
                    "that come near a target without reaching it, as descent lets them.",
                    f"targets used after {STEPS} steps of both terms, from 1e-9 apart",
                    targets_used(descend(apart(1e-9), STEPS, chamfer_gradient)[-1]),
                ),
            )
        ),
    )


def apart(distance: float) -> Points:
    """k points around q*, this far from it or up to a tenth farther, shape [k, 2]."""
    turn = np.arange(COUNT) / COUNT
    away = distance * (1 + 0.1 * turn[:, None])  # no two equally far, which would be ties
    points: Points = CENTER + away * directions(2 * np.pi * turn)
    return points


def moving(points: Points) -> npt.NDArray[np.bool_]:
    """Which points have a reverse gradient, shape [k]."""
    strong: npt.NDArray[np.bool_] = np.linalg.norm(reverse_gradient(points), axis=1) > 0
    return strong


def targets_used(points: Points) -> int:
    """Number of targets that are the nearest of some point."""
    return len(np.unique(nearest(points, TARGETS)))
