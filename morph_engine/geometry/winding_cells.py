"""Points in cells of space, where the winding number at the centre serves them all.

Along a path the winding number changes by one at each triangle that it crosses, and by the open
edges of a mesh: its gradient is at most the sum of L / (4 pi d^2) over them, of their lengths L and
distances d (the law of Biot and Savart). In a mesh without open edges, it is the same everywhere in
a cell that no triangle cuts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from morph_engine.counting_sort import counting_sort
from morph_engine.geometry.crossings import Cones, count_crossings
from morph_engine.geometry.point_cloud import extent

Floats = npt.NDArray[np.float64]

POINTS_PER_CELL = 512
"""Of the largest cells, if points were everywhere."""

MOST_ALONG = 512
"""Of the largest cells along an axis."""

HALVINGS = 2
"""How often cells that are cut are halved along each axis."""

EFFORT_PER_OPEN_EDGE, EFFORT_PER_TRIANGLE, EFFORT_PER_CROSSING = 0.02, 0.15, 0.035
"""What a smallest cell takes beside the winding number at its centre: an open edge, a triangle that
cuts it, and each pair of such a triangle and a point. Of the effort for a winding number."""

CLEARANCE = 1e-3
"""From the plane of a triangle, below which no path begins: the winding number there, found in
float32, could be that of the other side [cells]."""

ROUNDING = 1e-6
"""Of these float32 numbers, relative to the size of the mesh."""

MOST_PAIRS = 10_000_000
"""Triangles and cells near each other; with more it takes too long."""

MOST_OPEN_EDGES = 1000
"""With more of them, changes are too large, or take too long to find, to be of use."""

MARGIN = 1e-6
"""What cells are taken to be larger by, for rounding [cells]."""


@dataclass(frozen=True, eq=False)
class WindingCells:
    """Cells, and the points in them.

    Attributes:
        centres: Shape [c, 3].
        changes: What open edges change the winding number by from the centre to anywhere in the
            cell, at most; shape [c].
        cell: Of each point, shape [n]; -1 where it is in none.
        crossed: What the triangles between the centre and each point change it by, shape [n].
    """

    centres: Floats
    changes: Floats
    cell: npt.NDArray[np.intp]
    crossed: npt.NDArray[np.int8]


def winding_cells(
    points: Floats,
    vertices: Floats,
    faces: npt.NDArray[np.integer],
    open_edges: tuple[Floats, Floats],
) -> WindingCells:
    """Find cells for points, shape [n, 3], among triangles.

    Open edges, see `open_edges`, are those of the surface, at most `MOST_OPEN_EDGES`.
    """
    least, most = extent(points)
    span = most - least
    edge = float(np.cbrt(np.prod(span) * POINTS_PER_CELL / len(points)))
    edge = max(edge, float(span.max()) / MOST_ALONG) or 1.0  # of points in one place
    found = _Found(least, open_edges)
    cell, crossed = np.full(len(points), -1), np.zeros(len(points), np.int8)
    rest, place = np.arange(len(points)), (points - least) / edge
    for halving in range(HALVINGS + 1):
        size = (span / edge).astype(np.int64) + 1
        corners = (vertices - least) / edge
        key = _flat(place.astype(np.int64), size)
        cut, triangle = _cut(corners, faces, size)
        clear = _marked(key, size)
        clear[cut] = False
        cell[rest] = found.add(clear, size, edge)[key]
        is_cut = cell[rest] < 0
        rest, place, key = rest[is_cut], place[is_cut], key[is_cut]
        if halving < HALVINGS:
            place, edge = 2 * place, edge / 2

    if triangle is not None:  # in the smallest cells that are cut, triangles are counted
        worth = _worthwhile(key, cut, size, len(open_edges[0]))
        rest, place, key = rest[worth[key]], place[worth[key]], key[worth[key]]
        cut, triangle = cut[worth[cut]], triangle[worth[cut]]
        order, first = counting_sort(cut, len(worth))
        centres = _unflat(cut[order], size) + 0.5
        cones = Cones.behind(corners[faces[triangle[order]]] - centres[:, None])
        ends = place - np.floor(place) - 0.5
        clearance = max(CLEARANCE, ROUNDING * float(np.ptp(corners, axis=0).max()))
        change, doubtful = count_crossings(ends, first[key], first[key + 1], cones, clearance)
        sure = rest[~doubtful]
        crossed[sure] = change[~doubtful]
        cell[sure] = found.add(worth, size, edge)[key[~doubtful]]
    return WindingCells(np.concatenate(found.centres), np.concatenate(found.changes), cell, crossed)


class _Found:
    """Cells that have been found.

    Args:
        least: Where the first cell of all begins.
        open_edges: Of the surface.
    """

    def __init__(self, least: Floats, open_edges: tuple[Floats, Floats]) -> None:
        self.centres = [np.empty((0, 3))]
        self.changes = [np.empty(0)]
        self._least = least
        self._open_edges = open_edges
        self._count = 0

    def add(
        self, chosen: npt.NDArray[np.bool_], size: npt.NDArray[np.int64], edge: float
    ) -> npt.NDArray[np.int64]:
        """Add the chosen of the cells of an edge; returns the numbers of all, -1 of the others."""
        cells = np.flatnonzero(chosen)
        numbers = np.full(len(chosen), -1)
        numbers[cells] = np.arange(self._count, self._count + len(cells))
        self._count += len(cells)
        self.centres.append((_unflat(cells, size) + 0.5) * edge + self._least)
        self.changes.append(
            _largest_changes(self.centres[-1], np.sqrt(0.75) * edge, *self._open_edges)
        )
        return numbers


def _flat(cells: npt.NDArray[np.int64], size: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Indices of cells, shape [n], from their places, shape [n, 3]."""
    flat: npt.NDArray[np.int64] = np.ravel_multi_index(tuple(cells.T), tuple(size))
    return flat


def _unflat(cells: npt.NDArray[np.int64], size: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Places of cells, shape [n, 3], from their indices, shape [n]."""
    return np.stack(np.unravel_index(cells, size), axis=1)


def _worthwhile(
    key: npt.NDArray[np.int64], cut: npt.NDArray[np.int64], size: npt.NDArray[np.int64], edges: int
) -> npt.NDArray[np.bool_]:
    """Which cells save effort, with the cells of points and those of triangles that cut them."""
    points, triangles = (np.bincount(cells, minlength=size.prod()) for cells in (key, cut))
    of_triangles = triangles * (EFFORT_PER_TRIANGLE + EFFORT_PER_CROSSING * points)
    worth: npt.NDArray[np.bool_] = 1 + EFFORT_PER_OPEN_EDGE * edges + of_triangles < points
    return worth


def _marked(cells: npt.NDArray[np.int64], size: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Which of all cells are among these."""
    marked = np.zeros(size.prod(), np.bool_)
    marked[cells] = True
    return marked


def open_edges(vertices: Floats, faces: npt.NDArray[np.integer]) -> tuple[Floats, Floats]:
    """Middles of edges passed more often in one direction than in the other, and their lengths.

    Each length counts as often as the edge is passed too often.
    """
    corners = faces.astype(np.int64)
    begin, end = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    key = np.minimum(begin, end) * len(vertices) + np.maximum(begin, end)
    edges, which = np.unique(key, return_inverse=True)
    balance = np.bincount(which, weights=np.where(begin < end, 1, -1), minlength=len(edges))
    open_ones = np.flatnonzero(balance)
    ends = vertices[np.stack(np.divmod(edges[open_ones], len(vertices)))]
    lengths = np.abs(balance[open_ones]) * np.linalg.norm(ends[1] - ends[0], axis=1)
    long = lengths > 0  # others, of faces without area, change nothing
    return (ends[0] + ends[1])[long] / 2, lengths[long]


def _cut(
    vertices: Floats, faces: npt.NDArray[np.integer], size: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64] | None]:
    """Indices of cells that triangles cut, and of few others, and the triangle of each.

    All lengths are in cells. A triangle cuts none that its box, or its plane, leaves out. With too
    many to look at, all cells count as cut, by no triangle in particular.
    """
    triangles = vertices[faces]
    low = np.floor(triangles.min(axis=1) - MARGIN)
    high = np.floor(triangles.max(axis=1) + MARGIN)
    low, high = np.maximum(low, 0).astype(np.int64), np.minimum(high, size - 1).astype(np.int64)
    spans = np.maximum(high - low + 1, 0)
    counts = spans.prod(axis=1)
    if counts.sum() > MOST_PAIRS:
        return np.arange(size.prod()), None
    which = np.repeat(np.arange(len(faces)), counts)
    nth = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    span = spans[which]
    offset = np.stack([nth // (span[:, 1] * span[:, 2]), nth // span[:, 2] % span[:, 1], nth], 1)
    offset[:, 2] %= span[:, 2]
    cells = low[which] + offset
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    apart = np.abs(((cells + 0.5 - a[which]) * normal[which]).sum(axis=1))
    reach = (0.5 + MARGIN) * np.abs(normal).sum(axis=1) * (1 + MARGIN)
    near = apart <= reach[which]
    return _flat(cells[near], size), which[near]


def _largest_changes(centres: Floats, reach: float, middles: Floats, lengths: Floats) -> Floats:
    """What the winding number changes by within a reach of centres, at most."""
    change = np.zeros(len(centres))
    for middle, length in zip(middles, lengths, strict=True):
        apart = np.linalg.norm(centres - middle, axis=1) - length / 2 - reach
        with np.errstate(divide="ignore"):
            change += length / np.maximum(apart, 0) ** 2
    return change * reach / (4 * np.pi)
