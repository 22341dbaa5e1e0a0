"""Points in cells of space that a surface does not cut, where one winding number serves them all.

Along a path that crosses no triangle, the winding number changes by the open edges of a mesh alone:
its gradient is at most the sum of L / (4 pi d^2) over them, of their lengths L and distances d (the
law of Biot and Savart). In a mesh without open edges it does not change at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from morph_engine.geometry.point_cloud import extent

Floats = npt.NDArray[np.float64]

POINTS_PER_CELL = 512
"""Of the largest cells, if points were everywhere."""

MOST_ALONG = 512
"""Of the largest cells along an axis."""

HALVINGS = 2
"""How often cells that are cut are halved along each axis."""

MOST_PAIRS = 10_000_000
"""Triangles and cells near each other, or cells and open edges; with more it takes too long."""

MARGIN = 1e-6
"""What cells are taken to be larger by, for rounding [cells]."""


@dataclass(frozen=True, eq=False)
class ClearCells:
    """Cells that no triangle cuts.

    Attributes:
        centres: Shape [c, 3].
        changes: What the winding number changes by from the centre to anywhere in the cell, at
            most; shape [c].
        cell: Of each point, shape [n]; -1 where it is in none.
    """

    centres: Floats
    changes: Floats
    cell: npt.NDArray[np.intp]


def clear_cells(
    points: Floats,
    vertices: Floats,
    faces: npt.NDArray[np.integer],
    open_edges: tuple[Floats, Floats],
) -> ClearCells:
    """Find cells for points, shape [n, 3], among triangles.

    Open edges, see `open_edges`, are those of the surface.
    """
    least, most = extent(points)
    span = most - least
    edge = float(np.cbrt(np.prod(span) * POINTS_PER_CELL / len(points)))
    edge = max(edge, float(span.max()) / MOST_ALONG, 1e-300)
    cell = np.full(len(points), -1)
    rest, place = np.arange(len(points)), (points - least) / edge
    found, changes, count = [np.empty((0, 3))], [np.empty(0)], 0
    for _ in range(HALVINGS + 1):
        size = (span / edge).astype(np.int64) + 1
        x, y, z = place.T.astype(np.int64)
        key = (x * size[1] + y) * size[2] + z
        index = np.zeros(size.prod(), np.int64)
        index[key] = 1
        index[_cut((vertices - least) / edge, faces, size)] = 0
        clear = np.flatnonzero(index)
        index[:] = -1
        index[clear] = np.arange(count, count + len(clear))
        cell[rest] = index[key]
        centres = (np.stack(np.unravel_index(clear, size), axis=1) + 0.5) * edge + least
        found.append(centres)
        changes.append(_largest_changes(centres, np.sqrt(0.75) * edge, *open_edges))
        count += len(clear)
        cut = cell[rest] < 0
        rest, place, edge = rest[cut], 2 * place[cut], edge / 2
    return ClearCells(np.concatenate(found), np.concatenate(changes), cell)


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
    lengths = np.linalg.norm(ends[1] - ends[0], axis=1)
    return (ends[0] + ends[1]) / 2, np.abs(balance[open_ones]) * lengths


def _cut(
    vertices: Floats, faces: npt.NDArray[np.integer], size: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Indices of cells that triangles cut, and of few others; all lengths in cells.

    A triangle cuts none that its box, or its plane, leaves out.
    """
    triangles = vertices[faces]
    low = np.floor(triangles.min(axis=1) - MARGIN)
    high = np.floor(triangles.max(axis=1) + MARGIN)
    low, high = np.maximum(low, 0).astype(np.int64), np.minimum(high, size - 1).astype(np.int64)
    spans = np.maximum(high - low + 1, 0)
    counts = spans.prod(axis=1)
    if counts.sum() > MOST_PAIRS:
        return np.arange(size.prod())
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
    cells = cells[apart <= reach[which]]
    flat: npt.NDArray[np.int64] = (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]
    return flat


def _largest_changes(centres: Floats, reach: float, middles: Floats, lengths: Floats) -> Floats:
    """What the winding number changes by within a reach of centres, at most."""
    if len(centres) * len(middles) > MOST_PAIRS:
        return np.full(len(centres), np.inf)
    change = np.zeros(len(centres))
    for middle, length in zip(middles, lengths, strict=True):
        apart = np.linalg.norm(centres - middle, axis=1) - length / 2 - reach
        with np.errstate(divide="ignore"):
            change += length / np.maximum(apart, 0) ** 2
    return change * reach / (4 * np.pi)
