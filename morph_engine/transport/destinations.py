"""One destination per particle, spread evenly over the target's points.

Particles and target points are rarely equal in number. Where particles are fewer, neighbouring
target points share one, at their middle; where they are more, target points take two, on either
side. Which ones is chosen evenly over the volume, so that density stays even.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree

from morph_engine.transport.groups import Points, split, spread

HALF_PAIR = 0.3
"""Distance of two particles from the target point that they share [h]: far from each other, and
from neighbours on the lattice, which are not in the direction of a diagonal."""

DEEP = 6
"""Neighbours of a point below the surface."""

NEIGHBOR = 1.25
"""Points nearer than this are neighbours on a lattice whose points are moved by up to 0.1 [h]."""


def even_destinations(target: Points, count: int, spacing: float, seed: int = 0) -> Points:
    """Places for particles that fill a target evenly.

    Args:
        target: Target points on a lattice [dx], shape [m, 3], float64.
        count: Number of particles n.
        spacing: Spacing h of the lattice [dx].
        seed: Of the choice of points that are shared or doubled.

    Returns:
        Destinations [dx], shape [n, 3], float64.
    """
    rng = np.random.default_rng(seed)
    points = target
    while count > 2 * len(points):
        points, spacing = _doubled(points, np.arange(len(points)), spacing), spacing / 2
    if count > len(points):
        return _doubled(points, spread(points, count - len(points), rng), spacing)
    if count < len(points):
        return _shared(points, count, spacing, rng)
    return points


def _doubled(points: Points, chosen: NDArray[np.intp], spacing: float) -> Points:
    """Put two places in the place of each chosen point, along a diagonal of the lattice."""
    cell = np.rint((points[chosen] - points.min(axis=0)) / spacing).astype(int)
    signs = np.where(cell[:, [1, 2, 0]] % 2, 1.0, -1.0)  # neighbours take different diagonals
    offset = HALF_PAIR * spacing / np.sqrt(3) * signs
    rest = np.delete(points, chosen, axis=0)
    return np.concatenate([rest, points[chosen] - offset, points[chosen] + offset])


def _shared(points: Points, count: int, spacing: float, rng: np.random.Generator) -> Points:
    """Put one place in the middle of as many pairs of neighbours as there are points too many.

    Pairs below the surface come first, so that the outline stays where it is.
    """
    surplus = len(points) - count
    tree = cKDTree(points)
    edges = tree.query_pairs(NEIGHBOR * spacing, output_type="ndarray")
    deep = np.bincount(edges.ravel(), minlength=len(points)) >= DEEP
    for allowed in (deep, np.ones_like(deep)):
        pairs = _pairs(points, edges[allowed[edges].all(axis=1)], spacing)
        if len(pairs) >= surplus:
            middles = points[pairs].mean(axis=1)
            chosen = spread(middles, surplus, rng)
            rest = np.delete(points, pairs[chosen].ravel(), axis=0)
            return np.concatenate([rest, middles[chosen]])
    return split(points, count, rng).means(points)  # less than about one particle for two points


def _pairs(points: Points, edges: NDArray[np.intp], spacing: float) -> NDArray[np.intp]:
    """As many disjoint pairs of neighbours on the lattice as possible (Hopcroft and Karp).

    Args:
        points: Points of the lattice [dx], shape [m, 3].
        edges: Indices of neighbours that may become a pair, shape [e, 2].
        spacing: Spacing of the lattice [dx].

    Returns:
        Indices of the two points of each pair, shape [k, 2].
    """
    cell = np.rint((points - points.min(axis=0)) / spacing).astype(int)
    black = cell.sum(axis=1) % 2 == 0  # neighbours differ in colour
    edges = edges[black[edges[:, 0]] != black[edges[:, 1]]]
    edges = np.where(black[edges[:, :1]], edges, edges[:, ::-1])
    n = len(points)
    graph = csr_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    partner = maximum_bipartite_matching(graph, perm_type="column")
    first = np.flatnonzero(partner >= 0)
    return np.stack([first, partner[first]], axis=1).astype(np.intp)
