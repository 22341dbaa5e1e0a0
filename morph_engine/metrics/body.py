"""The body of a frame: the union of balls of radius 0.87 h around its particles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import igl
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.geometry.point_cloud import Points, finite_points
from morph_engine.geometry.surface_reconstruction import near_the_middle
from morph_engine.geometry.topology import signed_volume, triangle_areas
from morph_engine.metrics.chamfer import COVERING_RADIUS_OVER_H

STEPS_PER_H = 3
"""Raster steps per lattice spacing at which the area is taken."""

NEIGHBORS_OVER_H = 1.02
"""Where the nearest particles of a lattice are, over its spacing."""

SMALL_BLOCK, BLOCK = 1 << 18, 1 << 25
"""Raster cells that are looked at together: few where points are sparse, and at most these; the
domain of half edge 16 has 24 M at h = 1/3."""

CORNERS = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
)
"""Corners of a raster cell, in the order of libigl's marching cubes."""


@dataclass(frozen=True)
class Body:
    """What a body measures.

    Attributes:
        area: Of its whole surface, walls of inner cavities included [dx^2].
        volume: [dx^3].
        pieces: Connected pieces; a single stray particle is one.
        euler: Vertices - edges + faces of the surface: 2 (pieces + cavities - tunnels), down to
            pits between neighbouring balls; see `surface_euler` for holes that one can see.
    """

    area: float
    volume: float
    pieces: int
    euler: int


def measure_body(
    positions: npt.ArrayLike, spacing: float, *, steps_per_h: int = STEPS_PER_H
) -> Body:
    """Measure the body of a frame.

    The step is part of the area's definition, which does not converge where particles are
    shuffled: finer ones see ever smaller pits between the balls (docs/metrics.md). Compare areas
    at one step only; the volume converges.

    Args:
        positions: Particle positions [dx], shape [n, 3]. Those not finite take no part, and those
            far beyond the others are pieces only. With none left all is 0.
        spacing: Lattice spacing h of the particles at rest [dx].
        steps_per_h: Raster steps per spacing.

    Raises:
        MeshError: The positions have the wrong shape.
    """
    vertices, faces = body_surface(positions, spacing, steps_per_h=steps_per_h)
    points, _ = finite_points(positions)
    pieces = count_pieces(points, spacing)
    if not len(faces):
        return Body(area=0.0, volume=0.0, pieces=pieces, euler=0)
    return Body(
        area=float(triangle_areas(vertices, faces).sum()),
        volume=signed_volume(vertices, faces),
        pieces=pieces,
        euler=len(vertices) - len(faces) // 2,  # closed: three half edges a face
    )


def count_pieces(points: Points, spacing: float) -> int:
    """Number of connected pieces of the body: balls that touch belong together."""
    return len(piece_sizes(points, spacing))


def piece_sizes(points: Points, spacing: float) -> npt.NDArray[np.intp]:
    """Number of particles in each connected piece of the body."""
    if not len(points):
        return np.empty(0, np.intp)
    tree = scipy.spatial.cKDTree(points)
    neighbors = tree.query_pairs(NEIGHBORS_OVER_H * spacing, output_type="ndarray")
    group = _connected(len(points), neighbors)
    # most pieces are whole by now: what may still be linked is what is not of the largest
    others = np.flatnonzero(group != np.bincount(group).argmax())
    reach = 2 * COVERING_RADIUS_OVER_H * spacing
    near = scipy.spatial.cKDTree(points[others]).sparse_distance_matrix(
        tree, reach, output_type="ndarray"
    )
    links = np.column_stack((group[others[near["i"]]], group[near["j"]]))
    return np.bincount(_connected(group.max() + 1, links)[group])


def _connected(count: int, pairs: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.int32]:
    """The number of the connected part that each of some things is in, from 0."""
    graph = scipy.sparse.coo_array(
        (np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count)
    )
    labels: npt.NDArray[np.int32]
    _, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return labels


def body_surface(
    positions: npt.ArrayLike, spacing: float, *, steps_per_h: int = STEPS_PER_H
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """Surface of the body by marching cubes on the distance to the nearest particle.

    Particles that are not finite, or far beyond the others, take no part.

    Returns:
        Vertices [dx], shape [v, 3], float64, and faces, shape [f, 3], int32, counter-clockwise
        seen from outside. Both are empty where no particle is left.

    Raises:
        MeshError: The positions have the wrong shape.
    """
    points, _ = finite_points(positions)
    points = near_the_middle(points, spacing)
    if not len(points):
        return np.empty((0, 3)), np.empty((0, 3), np.int32)
    step, radius = spacing / steps_per_h, COVERING_RADIUS_OVER_H * spacing
    reach = radius / step + 1.0  # of a cell that the surface cuts, in steps
    margin = int(reach) + 2
    corner = np.floor(points.min(axis=0) / step) - margin
    place = points / step - corner
    shape = np.floor(place.max(axis=0)).astype(np.int64) + margin + 2
    nodes, values, cells, count = [], [], [], 0
    for low, high, near in _blocks(place, np.zeros(3, np.int64), shape - 1, margin):
        squared = _squared_distances(near, low, high, reach, margin)
        field = np.sqrt(squared) - np.float32(radius / step)
        used, corners = _cut_cells(field)
        where = np.stack(np.unravel_index(used, field.shape), axis=1) + low
        nodes.append(np.ravel_multi_index(tuple(where.T), tuple(shape)))
        values.append(field.reshape(-1)[used])
        cells.append(corners + count)
        count += len(used)
    node, first, which = np.unique(  # blocks share nodes at their faces
        np.concatenate(nodes), return_index=True, return_inverse=True
    )
    where = np.stack(np.unravel_index(node, tuple(shape)), axis=1)
    vertices, faces, _ = igl.marching_cubes(
        np.concatenate(values)[first].astype(np.float64),
        np.ascontiguousarray((where + corner) * step),
        which.reshape(-1)[np.concatenate(cells)],
        0.0,
    )
    return vertices, faces.astype(np.int32)


def _blocks(
    place: Points, low: npt.NDArray[np.int64], high: npt.NDArray[np.int64], margin: int
) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Points]]:
    """Split a raster into boxes of at most `BLOCK` cells, around the points only.

    So neither memory nor time follows the domain, or how far a particle has strayed.

    Args:
        place: Points [steps], shape [k, 3].
        low: First cell along each axis, shape [3].
        high: Cell after the last one, shape [3].
        margin: Cells around a point that may matter.

    Yields:
        The first cell, the one after the last, and the points within the margin.
    """
    low = np.maximum(low, np.floor(place.min(axis=0)).astype(np.int64) - margin)
    high = np.minimum(high, np.floor(place.max(axis=0)).astype(np.int64) + margin + 1)
    visited = len(place) * (4 * margin) ** 3  # more cells than points visit, by a few times
    if np.prod(high - low) <= min(max(visited, SMALL_BLOCK), BLOCK):
        yield low, high, place
        return
    axis = int(np.argmax(high - low))
    middle = (low + high) // 2
    along = np.arange(3) == axis
    for below, above in (
        (low, np.where(along, middle, high)),
        (np.where(along, middle, low), high),
    ):
        is_near = (place[:, axis] > below[axis] - margin) & (place[:, axis] < above[axis] + margin)
        if is_near.any():
            yield from _blocks(place[is_near], below, above, margin)


def _squared_distances(
    place: Points,
    low: npt.NDArray[np.int64],
    high: npt.NDArray[np.int64],
    reach: float,
    margin: int,
) -> npt.NDArray[np.float32]:
    """Squared distance from each node of a block to the nearest point, cut off near `reach`.

    Every point visits the nodes around it, so time follows the number of points.

    Args:
        place: Points [steps], shape [k, 3].
        low: First node along each axis, shape [3].
        high: Last node along each axis, shape [3].
        reach: Distance beyond which a node need not know its own [steps].
        margin: Nodes around a point that it may visit.

    Returns:
        Of the nodes from `low` to `high` [steps^2], shape high - low + 1, float32.
    """
    base = np.floor(place).astype(np.int64)
    corner = base.min(axis=0) - margin
    shape = tuple((base.max(axis=0) + margin + 2 - corner).tolist())
    field = np.full(int(np.prod(shape)), (reach + 1) ** 2, np.float32)
    first = np.ravel_multi_index(tuple((base - corner).T), shape)
    span = np.arange(-int(reach), int(reach) + 2)
    apart = (base - place)[:, :, None] + span  # [n, axis, offset]
    squares = np.ascontiguousarray(np.moveaxis(apart**2, 0, 2), np.float32)  # [axis, offset, n]
    least = np.maximum(np.maximum(span - 1, -span), 0)  # least distance from a cell to an offset
    for i, j, k in product(range(len(span)), repeat=3):
        if least[i] ** 2 + least[j] ** 2 + least[k] ** 2 > reach**2:
            continue
        node = first + (span[i] * shape[1] + span[j]) * shape[2] + span[k]
        np.minimum.at(field, node, squares[0, i] + squares[1, j] + squares[2, k])
    block = tuple(slice(a, b + 1) for a, b in zip(low - corner, high - corner, strict=True))
    return field.reshape(shape)[block]


def _cut_cells(
    field: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int64]]:
    """The cells of a raster in which its values change sign.

    Returns:
        Flat indices of their nodes, shape [k], and the 8 corners of each cell among these, shape
        [cells, 8].
    """
    inside = field < 0
    inner = tuple(slice(0, size - 1) for size in field.shape)
    count = np.zeros([size - 1 for size in field.shape], np.int8)
    for offset in CORNERS:
        count += inside[tuple(slice(o, o + s.stop) for o, s in zip(offset, inner, strict=True))]
    cells = np.argwhere((count > 0) & (count < 8))
    nodes = np.ravel_multi_index(tuple(np.moveaxis(cells[:, None] + CORNERS, 2, 0)), field.shape)
    needed = np.zeros(field.size, bool)
    needed[nodes] = True
    used = np.flatnonzero(needed)
    index = np.empty(field.size, np.int64)
    index[used] = np.arange(len(used))
    return used, index[nodes]
