"""The published program's neighbour search, for reproducing its numbers (algorithm 5.1).

It looks only into the 27 grid cells around a query: within one cell width the answer is exact,
beyond it may be a farther point, and without any point in the 27 cells there is no match.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from morph_engine.losses.matches import Matches
from morph_engine.mpm.grid import Grid

Points = NDArray[np.float64]


def restrict_to_cells(
    matches: Matches, x: Any, forward: Points, reverse: Points, grid: Grid
) -> tuple[Points, Points]:
    """Replace exact matches beyond one cell width by those of the 27-cell search.

    Matches are changed in place where the two differ. Distances particle -> target [dx], shape
    [n], and target -> particle, shape [m], come in exact and go out infinite without a match.
    """
    if max(forward.max(), reverse.max()) <= grid.dx:
        return forward, reverse
    particles = x.to_numpy().astype(np.float64)
    target = matches.target.to_numpy().astype(np.float64)
    for queries, points, index, distance in (
        (particles, target, matches.forward, forward),
        (target, particles, matches.reverse, reverse),
    ):
        far = np.flatnonzero(distance > grid.dx)
        if len(far):
            found = index.to_numpy()
            found[far], distance[far] = search_cells(queries[far], points, grid)
            index.from_numpy(found)
    return forward, reverse


def search_cells(queries: Points, points: Points, grid: Grid) -> tuple[NDArray[np.int32], Points]:
    """Nearest point within the 27 cells around each query.

    Returns:
        Index (-1 for none) and distance [dx] (infinite for none), shape [q].
    """
    side = grid.resolution + 2

    def cells(p: Points) -> NDArray[np.int64]:
        return np.clip(np.floor((p - grid.origin) / grid.dx), 0, side - 3).astype(int) + 1

    def key(cell: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.asarray((cell[:, 0] * side + cell[:, 1]) * side + cell[:, 2])

    keys = key(cells(points))
    order = np.argsort(keys, kind="stable")
    counts = np.bincount(keys, minlength=side**3)
    starts_of_cells = np.cumsum(counts) - counts
    home = cells(queries)
    best_index = np.full(len(queries), -1, np.int32)
    best_distance = np.full(len(queries), np.inf)
    for offset in np.ndindex(3, 3, 3):
        cell = key(home + np.array(offset) - 1)
        first, count = starts_of_cells[cell], counts[cell]
        some = np.flatnonzero(count)
        if not len(some):
            continue
        starts = np.cumsum(count[some]) - count[some]
        within = np.arange(count[some].sum()) - np.repeat(starts, count[some])
        candidate = order[np.repeat(first[some], count[some]) + within]
        query = np.repeat(some, count[some])
        distance = np.linalg.norm(queries[query] - points[candidate], axis=1)
        nearest = np.minimum.reduceat(distance, starts)
        at_minimum = np.flatnonzero(distance == np.repeat(nearest, count[some]))
        _, first_of_query = np.unique(query[at_minimum], return_index=True)
        found = candidate[at_minimum[first_of_query]]
        better = nearest < best_distance[some]
        best_index[some[better]] = found[better]
        best_distance[some[better]] = nearest[better]
    return best_index, best_distance
