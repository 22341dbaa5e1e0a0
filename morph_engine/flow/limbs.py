"""Limbs come from their roots and go from their tips, so that no piece of them is left alone.

The core of two shapes is where both are. A blend (1 - s) a + s b of their levels gives up a point
of the source at its share s = a / (a - b), and takes one of the target likewise. In these orders a
thin root may go before its thick limb does, or come after it. So points of the source have to go
before those nearer to the core do, and points of the target come after them: with t_x = -s_x in
the source, where the core has -1, and t_x = s_x in the target, where it has 0, x has its turn at

    T_x = max(t_x, min over neighbours y of T_y + |x - y| / pace)

so that what is below any T is connected to the core.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from morph_engine.distinct import distinct

Field = NDArray[np.float32]
Mask = NDArray[np.bool_]

LEAVING, ARRIVING = 25.0, 50.0
"""How far a limb retracts, or grows, in all, at most [dx]."""

LATEST = 0.95
"""Nothing waits longer than this share of the time that it has left."""

CORNER = 2.0
"""A limb lies farther from all balls of some radius that fit into its shape [radii]."""

ROOT = 2.5
"""How far its root reaches from it [radii]."""


def limbs_of(distance: Field, step: float, radius: float) -> Mask:
    """Limbs of a shape, where balls of some radius do not fit, and their roots.

    Args:
        distance: Signed distance to the shape on a cubic lattice [dx], shape [m, n, k].
        step: Lattice step [dx].
        radius: [dx].
    """
    inside, core = distance < 0, distance < -radius
    if not core.any():
        return inside
    limbs = inside & (_distance_to(core, step) > CORNER * radius)
    if not limbs.any():
        return limbs
    return inside & (_distance_to(limbs, step) < ROOT * radius)


def waiting(source: Field, target: Field, first: Field, last: Field, step: float) -> Field:
    """What the blend of two levels is raised by, so that limbs are not left by their roots.

    Args:
        source: Signed distance to the source on a cubic lattice [dx], shape [m, n, k].
        target: Signed distance to the target.
        first: Level at the source: below zero in it and nowhere else.
        last: Level at the target.
        step: Lattice step [dx].
    """
    raised = np.zeros_like(first)
    both = (source < 0) & (target < 0)
    core = _largest_piece(both)
    if not core.any():
        return raised
    height = np.abs(first) + np.abs(last)
    share = np.abs(first) / np.maximum(height, np.float32(1e-6))
    for shape, turn, least, end, pace in (
        (source, -share, -1.0, 0.0, LEAVING),
        (target, share, 0.0, 1.0, ARRIVING),
    ):
        turn = np.where(both, np.float32(least), turn)
        later = in_turn(turn, shape < 0, core, step / pace)
        alone = (shape < 0) & ~both & np.isfinite(later)
        latest = np.minimum(later, turn + LATEST * (end - turn))
        raised[alone] = (height * (latest - turn))[alone]
    around = scipy.ndimage.maximum_filter(raised, 5)
    return np.where((source < 0) | (target < 0), raised, around)


def in_turn(turn: Field, inside: Mask, core: Mask, delay: float) -> Field:
    """When each point has its turn; only neighbours of points whose turn has changed are looked at.

    Args:
        turn: t at the points of a lattice, shape [m, n, k].
        inside: The points that have a turn.
        core: Those of them that have t; the others follow their neighbours.
        delay: Of one lattice step.

    Returns:
        T, infinite outside and where the core is not reached.
    """
    infinite = np.float32(np.inf)
    turn = np.pad(np.where(inside, turn, infinite), 1, constant_values=infinite)
    reached = np.where(np.pad(core, 1), turn, infinite)
    turn_of, reached_at = turn.ravel(), reached.ravel()
    steps = [np.intp(stride // reached.itemsize) for stride in reached.strides]
    changed = np.flatnonzero(np.isfinite(reached_at))
    while len(changed):
        later = reached_at[changed] + np.float32(delay)
        nearer = []
        for step in (*steps, *np.negative(steps)):
            there = changed + step
            proposed = np.maximum(later, turn_of[there])
            sooner = proposed < reached_at[there]
            there = there[sooner]
            reached_at[there] = proposed[sooner]
            nearer.append(there)
        changed = distinct(np.concatenate(nearer))
    return reached[1:-1, 1:-1, 1:-1]


def _largest_piece(mask: Mask) -> Mask:
    pieces, count = scipy.ndimage.label(mask)
    largest: Mask = pieces == (1 + np.argmax(np.bincount(pieces.ravel())[1:]) if count else -1)
    return largest


def _distance_to(mask: Mask, step: float) -> Field:
    distance: Field = scipy.ndimage.distance_transform_edt(~mask)
    distance *= step
    return distance
