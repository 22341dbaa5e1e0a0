"""One destination per particle, spread evenly over the target's points.

Particles and target points are rarely equal in number. Where particles are fewer, neighbouring
target points share one, at their middle; where they are more, target points take two, on either
side. Which ones is chosen evenly over the volume, so that density stays even.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morph_engine.optimal_transport.partition import Points, spread

HALF_PAIR = 0.3
"""Distance of two particles from the target point that they share [h]: far from each other, and
from neighbours on the lattice, which are not in the direction of a diagonal."""

SHRINK = 0.99
"""By what the edge of a lattice that holds too few points shrinks before it is tried again."""


def even_destinations(target: Points, count: int, spacing: float, seed: int = 0) -> Points:
    """Places for particles that fill a target evenly.

    Args:
        target: Target points [dx], shape [m, 3], float64; a lattice is filled most evenly.
        count: Number of particles n.
        spacing: Spacing h of the lattice, or what is usual in the cloud [dx].
        seed: Of the choice of points that are shared or doubled.

    Returns:
        Destinations [dx], shape [n, 3], float64.
    """
    rng = np.random.default_rng(seed)
    if count < len(target):
        return _shared(target, count, spacing, rng)
    if count == len(target):
        return target.copy()
    points, is_inside = target, _is_inside(target, spacing)
    while count > 2 * len(points):
        points, spacing = _doubled(points, np.arange(len(points)), spacing), spacing / 2
        is_inside = np.tile(is_inside, 2)
    return _doubled(points, _inside_first(points, is_inside, count - len(points), rng), spacing)


def random_destinations(target: Points, count: int, seed: int = 0) -> Points:
    """Target points drawn at random [dx], shape [count, 3], float64, to see what evenness is worth.

    Beyond the number of target points all are taken, and some again.
    """
    rng = np.random.default_rng(seed)
    rounds = -(-count // len(target))
    chosen = np.concatenate([rng.permutation(len(target)) for _ in range(rounds)])[:count]
    drawn: Points = target[chosen]
    return drawn


def _is_inside(points: Points, spacing: float) -> NDArray[np.bool_]:
    """Which points have neighbours on all six sides, shape [m]."""
    cell, index = _lattice(points, spacing)
    steps = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    sides: NDArray[np.bool_] = np.all(
        [index[tuple((cell + step).T)] >= 0 for step in steps], axis=0
    )
    return sides


def _inside_first(
    points: Points, is_inside: NDArray[np.bool_], number: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Choose points evenly, those at the surface last: in their place two might stick out."""
    inside, surface = np.flatnonzero(is_inside), np.flatnonzero(~is_inside)
    more = max(number - len(inside), 0)
    return np.concatenate(
        [
            inside[spread(points[inside], number - more, rng)],
            surface[spread(points[surface], more, rng)],
        ]
    )


def _doubled(points: Points, chosen: NDArray[np.intp], spacing: float) -> Points:
    """Put two places in the place of each chosen point, along a diagonal of the lattice."""
    cell = _lattice(points, spacing)[0][chosen]
    signs = np.where(cell[:, [1, 2, 0]] % 2, 1.0, -1.0)  # neighbours take different diagonals
    offset = HALF_PAIR * spacing / np.sqrt(3) * signs
    rest = np.delete(points, chosen, axis=0)
    return np.concatenate([rest, points[chosen] - offset, points[chosen] + offset])


def _shared(points: Points, count: int, spacing: float, rng: np.random.Generator) -> Points:
    """Put one place in the middle of as many pairs of neighbours as there are points too many.

    Pairs with a point beyond either end come first, so that the outline stays where it is.
    """
    inner, outer = _bricks(points, spacing)
    surplus = len(points) - count
    if surplus > len(inner) + len(outer):
        return _body_centred(points, count, spacing, rng)
    more = max(surplus - len(inner), 0)
    chosen = [
        pairs[spread(points[pairs].mean(axis=1), number, rng)]
        for pairs, number in ((inner, surplus - more), (outer, more))
    ]
    shared = np.concatenate(chosen)
    rest = np.delete(points, shared.ravel(), axis=0)
    return np.concatenate([rest, points[shared].mean(axis=1)])


def _bricks(points: Points, spacing: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of neighbours along one axis, laid like bricks: each row half a brick further.

    If every pair shares a place, these form a face-centred lattice, whose balls of 0.87 h leave
    1 % of the volume open; pairs in arbitrary directions leave 7 %.

    Returns:
        Indices of the two points of each pair, shape [k, 2]: of pairs inside the shape along the
        axis, and of pairs at its surface.
    """
    cell, index = _lattice(points, spacing)
    is_first = cell.sum(axis=1) % 2 == 0
    # of a cloud that is no lattice, several points may lie in a cell; one of them pairs
    first = np.flatnonzero(is_first & (index[tuple(cell.T)] == np.arange(len(points))))
    choices = []
    for axis in np.eye(3, dtype=int):
        before, second, after = (index[tuple((cell[first] + k * axis).T)] for k in (-1, 1, 2))
        is_pair = second >= 0
        is_inner = is_pair & (before >= 0) & (after >= 0)
        pairs = np.stack([first, second], axis=1)
        choices.append((pairs[is_inner], pairs[is_pair & ~is_inner]))
    return max(choices, key=lambda choice: len(choice[0]))


def _body_centred(points: Points, count: int, spacing: float, rng: np.random.Generator) -> Points:
    """Places on a body-centred lattice inside the shape: the farthest from each other there are."""
    tree = cKDTree(points)
    lower, upper = points.min(axis=0) - spacing, points.max(axis=0) + spacing
    edge = (2 * len(points) / count) ** (1 / 3) * spacing
    while True:
        axes = (np.arange(a, b + edge, edge) for a, b in zip(lower, upper, strict=True))
        corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        places = np.concatenate([corners, corners + edge / 2])
        distance, nearest = tree.query(places, distance_upper_bound=spacing)
        places, nearest = places[np.isfinite(distance)], nearest[np.isfinite(distance)]
        places = places[(np.abs(places - points[nearest]) <= spacing / 2).all(axis=1)]
        if len(places) >= count:
            chosen: Points = places[spread(places, count, rng)]
            return chosen
        edge *= SHRINK


def _lattice(points: Points, spacing: float) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Where on their lattice points are, even if moved by up to 0.1 h.

    Returns:
        Cell of each point, shape [m, 3], and a point of each cell, -1 in empty ones, of which two
        layers surround the shape.
    """
    cell: NDArray[np.int_] = np.rint((points - points.min(axis=0)) / spacing).astype(int) + 2
    index = np.full(cell.max(axis=0) + 3, -1)
    index[tuple(cell.T)] = np.arange(len(points))
    return cell, index
