"""Optimal transport between two sets of equally many points, nearly exact.

The sum of squared distances is lowered in two stages. Compact groups of particles and of
destinations are assigned to each other exactly; then particles near each other exchange their
destinations optimally, in ever other groups of some hundred. Both are linear assignment problems
that scipy solves. A few sweeps reach the optimum to within a per cent or two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from morph_engine.optimal_transport.partition import Indices, Points, split

COARSE_SIZE = 16
COARSE_LIMIT = 1024
"""Most groups of the first stage, whose cost grows with their number cubed."""


def transport_plan(
    source: Points,
    destinations: Points,
    *,
    sweeps: int = 8,
    group: int = 100,
    seed: int = 0,
) -> NDArray[np.intp]:
    """Hand out destinations so that the sum of squared distances is as small as possible.

    Args:
        source: Where particles are [dx], shape [n, 3], float64.
        destinations: Where one of them shall be [dx], shape [n, 3], float64.
        sweeps: Rounds of exchanges.
        group: Particles that exchange destinations at a time.
        seed: Of the groups.

    Returns:
        Index of each particle's destination, a permutation, shape [n].
    """
    rng = np.random.default_rng(seed)
    plan = _coarse(source, destinations, rng)
    count = -(-len(source) // group)
    for sweep in range(sweeps):
        goals = destinations[plan]
        near = (source, goals, (source + goals) / 2)[sweep % 3]
        for members in split(near, count, rng):
            mine = plan[members]
            order = _cheapest(source[members], destinations[mine])
            plan[members] = mine[order]
    return plan


def _coarse(source: Points, destinations: Points, rng: np.random.Generator) -> Indices:
    """Groups of particles to groups of destinations; within them in arbitrary order."""
    count = min(max(len(source) // COARSE_SIZE, 1), COARSE_LIMIT)
    here, there = split(source, count, rng), split(destinations, count, rng)
    partner = _cheapest(here.means(source), there.means(destinations))
    goals = list(there)
    plan = np.empty(len(source), np.intp)  # sizes differ a little, so the surplus moves on
    plan[here.order] = np.concatenate([goals[index] for index in partner])
    return plan


def _cheapest(source: Points, destinations: Points) -> Indices:
    """Index of the destination of each point at the least sum of squared distances."""
    centre = source.mean(axis=0)  # |x - y|^2 = |x|^2 + |y|^2 - 2 x.y, where only x.y depends on it
    order: Indices = linear_sum_assignment((source - centre) @ destinations.T, maximize=True)[1]
    return order
