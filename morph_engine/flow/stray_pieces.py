"""Small pieces that came off the body are brought back to it.

Where a limb withdraws or a handle breaks, a few particles may stay behind. Two particles are linked
where balls that cover a lattice of the spacing h touch, as in `metrics.count_pieces`.

Lengths are in the unit of the grid of the cell list, written [dx]: in the method `flow` its cells.
"""

from functools import cached_property
from operator import itemgetter
from typing import Any

import numpy as np
import scipy.spatial
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.flow.cell_list import LANES, CellList, cell_of, column_of, load_lanes
from morph_engine.metrics.body import piece_sizes
from morph_engine.metrics.chamfer import COVERING_RADIUS_OVER_H

LINK: float = 2 * COVERING_RADIUS_OVER_H
"""Particles closer than this are linked [h]."""

REJOINED = 1.6
"""Distance from the body to which a piece is brought [h]."""

FEW = 8
"""A small piece has particles with at most so many links; a point inside a lattice has 26."""

LARGEST = 1e-3
"""Share of all particles that a stray piece has, at most."""


class StrayPieces:
    """Brings stray pieces back: those with fewer particles than any piece of the ends has.

    Args:
        ends: Particles of source and target [dx], shape [n, 3] and [m, 3].
        spacing: Lattice spacing h of both [dx].
        cells: Lists the particles.
    """

    def __init__(self, ends: list[NDArray[Any]], spacing: float, cells: CellList) -> None:
        self._ends = ends
        self._spacing = spacing
        self._cells = cells
        self._few = backend.active().integers(cells.order.shape[0])

    def gather(self, x: Any, moved: Any, spacing: float) -> None:
        """Bring each back to the body as it is, by the shortest move.

        Args:
            x: Positions [dx], device array, shape [n, 3]; changed in place.
            moved: What each particle is moved is added to this [dx], shape [n].
            spacing: Lattice spacing of the particles by now [dx].
        """
        starts = self._with_few_links(x, LINK * spacing)
        if not len(starts):
            return
        positions = x.to_numpy()
        pieces = self._find(positions, starts, LINK * spacing)
        if not pieces:
            return
        lengths = moved.to_numpy()
        trees = [_tree(np.delete(positions, np.concatenate(pieces), axis=0))]
        for piece in pieces:
            gap, vector = _to_nearest(positions[piece], trees)
            move = (1 - REJOINED * spacing / gap) * vector
            positions[piece] += move
            lengths[piece] += np.linalg.norm(move)
            trees.append(_tree(positions[piece]))  # the next one keeps away from it
        x.from_numpy(positions)
        moved.from_numpy(lengths)

    def _with_few_links(self, x: Any, reach: float) -> NDArray[np.intp]:
        """Particles that few others are linked to, where those closer than `reach` are [dx]."""
        cells, few = self._cells, self._few
        cells.build(x)
        _mark_few_links(
            x, few, cells.box, cells.first, *cells.columns, cells.origin, cells.edge, reach
        )
        return np.flatnonzero(few.to_numpy())

    def _find(
        self, positions: NDArray[Any], starts: NDArray[np.intp], reach: float
    ) -> list[NDArray[np.intp]]:
        """The stray pieces that hold one of `starts`."""
        pieces = find_small_pieces(positions, starts, reach, int(LARGEST * len(positions)))
        return [piece for piece in pieces if len(piece) <= self._largest]

    @cached_property
    def _largest(self) -> int:
        """Particles of a stray piece, at most; found once there is a small piece at all."""
        pieces = [(len(end), piece_sizes(end, self._spacing).min()) for end in self._ends]
        least = min(size / count for count, size in pieces)
        return int(len(self._ends[0]) * min(LARGEST, least / 2))


def find_small_pieces(
    x: NDArray[Any], starts: NDArray[np.intp], reach: float, largest: int
) -> list[NDArray[np.intp]]:
    """Connected pieces of at most `largest` particles that hold one of `starts`.

    Args:
        x: Positions [dx], shape [n, 3].
        starts: Particles to begin at.
        reach: Particles closer than this are linked [dx].
        largest: Number of particles.
    """
    tree = _tree(x)
    seen: set[int] = set()
    pieces = []
    for start in starts.tolist():
        piece, border = {start}, {start}
        while border and len(piece) <= largest and seen.isdisjoint(border):
            linked = tree.query_ball_point(x[sorted(border)], reach)
            border = set().union(*linked) - piece
            piece |= border
        if not border and len(piece) <= largest:
            pieces.append(np.array(sorted(piece)))
        seen |= piece
    return pieces


def _tree(x: NDArray[Any]) -> scipy.spatial.cKDTree:
    """A tree that is quick to build rather than to search, for few places are looked at."""
    return scipy.spatial.cKDTree(x, leafsize=64, balanced_tree=False, compact_nodes=False)


def _to_nearest(
    piece: NDArray[Any], trees: list[scipy.spatial.cKDTree]
) -> tuple[float, NDArray[Any]]:
    """The least distance between a piece and others, and the vector there [dx], shape [3]."""
    found = []
    for tree in trees:
        gaps, nearest = tree.query(piece)
        first = int(np.argmin(gaps))
        goal = tree.data[nearest[first]].astype(piece.dtype)
        found.append((float(gaps[first]), goal - piece[first]))
    return min(found, key=itemgetter(0))


@ti.kernel
def _mark_few_links(
    x: ti.types.ndarray(),
    few: ti.types.ndarray(),
    box: ti.types.ndarray(),
    first: ti.types.ndarray(),
    x_column: ti.types.ndarray(),
    y_column: ti.types.ndarray(),
    z_column: ti.types.ndarray(),
    origin: float,
    edge: float,
    reach: float,
):
    for p in range(x.shape[0]):
        low = cell_of(x[p] - reach, box, origin, edge)
        high = cell_of(x[p] + reach, box, origin, edge)
        links = -1  # to itself
        for i in range(low.x, high.x + 1):
            for j in range(low.y, high.y + 1):
                row = column_of(i, j, box)
                begin, end = first[row + low.z], first[row + high.z + 1]
                groups = (end - begin + LANES - 1) // LANES if links <= FEW else 0
                for group in range(groups):
                    slot = begin + group * LANES
                    away_x = x[p].x - load_lanes(x_column, slot)
                    away_y = x[p].y - load_lanes(y_column, slot)
                    away_z = x[p].z - load_lanes(z_column, slot)
                    squared = away_x**2 + away_y**2 + away_z**2
                    for lane in ti.static(range(LANES)):
                        links += int(slot + lane < end and squared[lane] < reach * reach)
        few[p] = int(links <= FEW)
