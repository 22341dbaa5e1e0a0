"""Proposition 3: a penalty of the cluster's own points does not move its centroid.

A penalty that is invariant under translation has gradients that sum to zero, so that the centroid
moves by 2 eta / N (centroid - q*) per step, whatever the penalty's weight.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.config import PlanarConfig
from chamfer_morph.reproduction.planar.optimizer import Optimizer
from chamfer_morph.reproduction.planar.repulsion import repulsion
from chamfer_morph.reproduction.propositions.check import Check, Limit, Quantity
from chamfer_morph.reproduction.propositions.penalties import (
    PENALTIES,
    neighbor_lists,
    repulsion_penalty,
)
from chamfer_morph.reproduction.propositions.scene import (
    CENTER,
    cluster,
    elsewhere,
    forward_gradient,
)

Points = npt.NDArray[np.float64]

NEIGHBORS = 4
WEIGHTS = (1e-3, 1.0, 1e3)
LIMIT_WEIGHT = 1e-3
"""The limits are shown with the smallest of the weights already."""


def proposition_3() -> Check:
    """Measure the centroid's drift under three penalties, and where the proposition ends."""
    points = cluster()
    return Check(
        name="Proposition 3",
        statement=(
            "A local penalty that is invariant under translation leaves the drift of a cluster's "
            "centroid at 2 eta/N towards q*, whatever its weight."
        ),
        quantities=tuple(
            Quantity(
                f"drift over 2 eta/N (centroid - q*), {name} with weight {weight:g}",
                drift(points, penalty_force(name, points, weight)),
                1.0,
                tolerance=1e-6,  # the rounding of a sum of forces of up to 1e8
            )
            for name in PENALTIES
            for weight in WEIGHTS
        ),
        limits=tuple(
            Limit(case, Quantity(name, measured, 1.0, tolerance=1e-3))
            for case, name, measured in (
                (
                    "Neighbour lists that cross the cluster's boundary push it as a whole.",
                    "drift ratio, repulsion between all points, weight 0.001",
                    crossing_drift(LIMIT_WEIGHT),
                ),
                (
                    "A force on each point from its k nearest, without the reaction on them, as in "
                    "the paper's 2D experiment, is no penalty's gradient and does not sum to zero.",
                    "drift ratio, one-sided repulsion, weight 0.001",
                    one_sided_drift(LIMIT_WEIGHT),
                ),
                (
                    "Adam scales each component by its own history, so that forces that cancel no "
                    "longer do: the weight changes the drift.",
                    "centroid's way in 20 steps of Adam, weight 0.001 over weight 0",
                    adam_displacement(LIMIT_WEIGHT) / adam_displacement(0.0),
                ),
                (
                    "Weights per point, as in density-aware losses, are no added penalty: the "
                    "centroid follows the points that weigh more.",
                    "drift ratio, forward term weighted by 1/(distance to 4 nearest)",
                    _weighted_drift(points),
                ),
            )
        ),
    )


def penalty_force(name: str, points: Points, weight: float) -> Points:
    """-weight dR/dp with lists inside these points, shape [n, 2]."""
    return -weight * PENALTIES[name](points, neighbor_lists(points, NEIGHBORS))[1]


def drift(points: Points, force: Points, *, members: int | None = None) -> float:
    """The centroid's drift towards q* as a multiple of the proposition's.

    Args:
        points: Shape [n, 2], float64; the cluster's members come first.
        force: What is added to the descent direction of the forward term, shape [n, 2].
        members: Size of the cluster; all points without it.

    Returns:
        1 where the drift is 2 eta / N (centroid - q*), for any eta.
    """
    velocity = force - forward_gradient(points)
    centroid = points[:members].mean(axis=0) - CENTER
    step = velocity[:members].mean(axis=0)
    return float(-step @ centroid / (2 / len(points) * centroid @ centroid))


def crossing_drift(weight: float) -> float:
    """Drift of the cluster when repulsion acts between all points of the scene."""
    members = cluster()
    points = np.vstack([members, elsewhere()])
    gradient = repulsion_penalty(points, neighbor_lists(points, len(points) - 1))[1]
    return drift(points, -weight * len(points) * gradient, members=len(members))


def one_sided_drift(weight: float) -> float:
    """Drift of the cluster under the repulsive force of the 2D experiment among its points."""
    points = cluster()
    return drift(points, weight * repulsion(points, neighbors=NEIGHBORS))


def adam_displacement(weight: float) -> float:
    """How far 20 steps of Adam move the centroid, with repulsion of this weight in the cluster."""
    points = start = cluster()
    descent = Optimizer(PlanarConfig(optimizer="adam", learning_rate=0.002))
    for _ in range(20):
        force = penalty_force("repulsion", points, weight)
        points = points - descent(forward_gradient(points) - force)
    return float(np.linalg.norm((points - start).mean(axis=0)))


def _weighted_drift(points: Points) -> float:
    """Drift when each point's gradient is weighted by its density (algorithm 8.3)."""
    lists = neighbor_lists(points, NEIGHBORS)
    distance = np.linalg.norm(points[:, None] - points[lists], axis=-1).mean(axis=1)
    weight = len(points) / distance / np.sum(1 / distance)
    return drift(points, (1 - weight)[:, None] * forward_gradient(points))
