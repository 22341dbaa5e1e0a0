"""Proposition 1: within one Voronoi cell the forward term collapses all points onto its target.

The forward gradient of a point whose nearest target is q* is 2 / N (p - q*), its Hessian
2 / N times the identity; plain descent contracts by 1 - 2 eta / N per step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.chamfer import nearest
from chamfer_morph.reproduction.propositions.check import Check, Limit, Quantity
from chamfer_morph.reproduction.propositions.scene import (
    CENTER,
    TARGETS,
    Gradient,
    chamfer_gradient,
    cluster,
    forward_gradient,
)

Points = npt.NDArray[np.float64]
Coupling = Callable[[Points, Points], Points]
"""Velocity, shape [n, 2], from positions and the descent direction of each point."""

RATE = 0.05
"""2 eta / N of the runs: the share of the way that one step covers."""

STEPS = 200


def proposition_1() -> Check:
    """Measure gradient, Hessian, contraction and end state of a cluster in one cell."""
    points = cluster()
    count = len(points)
    curvature = count / 2 * _hessian(points)
    way = descend(points, STEPS)
    distance = np.linalg.norm(way - CENTER, axis=-1)
    contraction = distance[1:] / distance[:-1]
    return Check(
        name="Proposition 1",
        statement=(
            "Points that share their nearest target q* have one equilibrium under the forward "
            "term, all of them at q*, and it is stable."
        ),
        quantities=(
            Quantity(
                "largest deviation of the gradient from 2/N (p - q*)",
                float(abs(forward_gradient(points) - 2 / count * (points - CENTER)).max()),
                0.0,
                tolerance=1e-15,
            ),
            Quantity(
                "largest deviation of the joint Hessian from 2/N I, in units of 2/N",
                float(abs(curvature - np.eye(2 * count)).max()),
                0.0,
                tolerance=1e-8,  # rounding of a difference quotient with step 1e-6
            ),
            Quantity(
                "contraction per step, smallest over points and steps",
                float(contraction.min()),
                1 - RATE,
                tolerance=1e-9,
            ),
            Quantity(
                "contraction per step, largest", float(contraction.max()), 1 - RATE, tolerance=1e-9
            ),
            Quantity(
                f"diameter after {STEPS} steps, as a share of the first",
                _diameter(way[-1]) / _diameter(way[0]),
                (1 - RATE) ** STEPS,
                tolerance=1e-9,
            ),
        ),
        limits=(
            Limit(
                "The statement is about one cell: as many points as targets, one in each cell, "
                "come to rest at distinct targets.",
                Quantity("points per occupied target at rest", _points_per_target(), 2.0, ">="),
            ),
            Limit(
                "With the reverse term, too, members leave the cell before they collapse, pulled "
                "by targets that no other point is nearer to.",
                Quantity("members whose nearest target is still q*, as a share", _stayed(), 1.0),
            ),
        ),
    )


def descend(
    points: Points,
    steps: int,
    gradient: Gradient = forward_gradient,
    coupling: Coupling = lambda points, direction: direction,
) -> Points:
    """Plain descent with 2 eta / N = `RATE`: the positions before and after each step.

    Args:
        points: Shape [n, 2], float64.
        steps: How many.
        gradient: Of which terms.
        coupling: Velocity from the positions and the descent direction of each point.

    Returns:
        Shape [steps + 1, n, 2].
    """
    way = [points]
    for _ in range(steps):
        direction = -gradient(way[-1])
        way.append(way[-1] + RATE * len(points) / 2 * coupling(way[-1], direction))
    return np.stack(way)


def _hessian(points: Points, step: float = 1e-6) -> Points:
    """Derivative of the forward gradient by central differences, shape [2 n, 2 n]."""
    columns = []
    for index in range(points.size):
        ahead, behind = points.copy(), points.copy()
        ahead.flat[index] += step
        behind.flat[index] -= step
        change = forward_gradient(ahead) - forward_gradient(behind)
        columns.append(change.ravel() / (2 * step))
    return np.column_stack(columns)


def _diameter(points: Points) -> float:
    return float(np.linalg.norm(points[:, None] - points[None], axis=-1).max())


def _points_per_target() -> float:
    """Points per distinct position at rest, of one point in each cell."""
    shifted = TARGETS + np.random.default_rng(2).uniform(-0.2, 0.2, TARGETS.shape)
    rest = descend(shifted, STEPS)[-1]
    return len(rest) / len(np.unique(nearest(rest, TARGETS)))


def _stayed() -> float:
    rest = descend(cluster(), STEPS, chamfer_gradient)[-1]
    return float(np.mean(nearest(rest, TARGETS) == 0))
