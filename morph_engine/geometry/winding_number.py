"""Inside test: the generalised winding number of a mesh at points."""

from __future__ import annotations

from typing import Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.winding_cells import MOST_OPEN_EDGES, open_edges, winding_cells

igl: Any = lazy.load("igl")

Floats = npt.NDArray[np.float64]

EDGES_PER_DIAGONAL = 40
HALVING_LIMIT = 400_000

CUTS_PER_FACE = 200
"""Where cutting long triangles makes this many of each, summing over the whole ones is faster."""

FAST_WINDING_ERROR = 0.02
"""Bound on the error of the fast winding number away from the surface."""

FEWEST_IN_CELLS, FEWEST_PER_FACE = 50_000, 5
"""Points that are evaluated one by one where there are fewer, or fewer for each face."""


def winding_number(mesh: Mesh, points: npt.ArrayLike) -> Floats:
    """Generalised winding number: 1 inside, 0 outside, fractional near holes.

    Points are in the coordinates of the mesh, shape [n, 3]; the mesh may have holes, loose
    triangles and overlapping parts.

    Returns:
        Winding numbers, shape [n], float64, by libigl's fast tree approximation
        (Barill et al., "Fast winding numbers for soups and clouds", 2018), or exactly where few
        large triangles make up the mesh. The tree works in float32 within, so the mesh is brought
        to unit size at the origin first.
    """
    lower, upper = mesh.bounds
    centre, size = (lower + upper) / 2, (upper - lower).max()
    vertices, faces = _without_long_edges(mesh)
    if len(faces) > CUTS_PER_FACE * len(mesh.faces):
        return _exact_winding_number(mesh, points)
    queries = (np.asarray(points, np.float64) - centre) / size
    winding = igl.fast_winding_number((vertices - centre) / size, faces, queries)
    return np.asarray(winding, np.float64)


def _exact_winding_number(mesh: Mesh, points: npt.ArrayLike) -> Floats:
    queries = np.ascontiguousarray(points, np.float64)
    winding = igl.winding_number(mesh.vertices, mesh.faces.astype(np.int64), queries)
    return np.asarray(winding, np.float64)


def _without_long_edges(mesh: Mesh) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Halve long triangles, which leaves every winding number as it is.

    Slivers across the whole mesh, usual in letters and CAD models, defeat the tree of the fast
    winding number: it then visits nearly every triangle for every point.
    """
    limit = np.linalg.norm(np.ptp(mesh.bounds, axis=0)) / EDGES_PER_DIAGONAL
    triangles = mesh.vertices[mesh.faces]
    done = [triangles[:0]]
    while len(triangles) and len(triangles) < HALVING_LIMIT:
        length = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        long = length.max(axis=1) > limit
        done.append(triangles[~long])
        first = length[long].argmax(axis=1)[:, None] + np.arange(3)
        a, b, c = np.moveaxis(triangles[long][np.arange(len(first))[:, None], first % 3], 1, 0)
        middle = (a + b) / 2
        triangles = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    corners = np.concatenate([*done, triangles]).reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def inside(mesh: Mesh, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Mask of the points with a winding number of at least 1/2 (algorithm 1.2, step 5).

    The few points that the fast winding number leaves in doubt are evaluated exactly. Where there
    are many, one evaluation serves those of a cell, see `WindingCells`. Points are in the mesh's
    coordinates, shape [n, 3].
    """
    queries = np.ascontiguousarray(points, np.float64)
    if len(queries) < max(FEWEST_IN_CELLS, FEWEST_PER_FACE * len(mesh.faces)):
        return _each_inside(mesh, queries)
    edges = open_edges(mesh.vertices, mesh.faces)
    if len(edges[0]) > MOST_OPEN_EDGES:
        return _each_inside(mesh, queries)
    cells = winding_cells(queries, *_without_long_edges(mesh), edges)
    single = np.flatnonzero(cells.cell < 0)
    winding = winding_number(mesh, np.concatenate([cells.centres, queries[single]]))
    which = cells.cell
    which[single] = len(cells.centres) + np.arange(len(single))
    changes = np.append(cells.changes, np.zeros(len(single)))
    here = winding[which] + cells.crossed
    doubtful = np.abs(here - 0.5) < FAST_WINDING_ERROR + changes[which]
    answer: npt.NDArray[np.bool_] = here >= 0.5
    if doubtful.any():
        answer[doubtful] = _each_inside(mesh, queries[doubtful])
    return answer


def _each_inside(mesh: Mesh, queries: Floats) -> npt.NDArray[np.bool_]:
    winding = winding_number(mesh, queries)
    doubtful = np.flatnonzero(np.abs(winding - 0.5) < FAST_WINDING_ERROR)
    if doubtful.size:
        winding[doubtful] = _exact_winding_number(mesh, queries[doubtful])
    return winding >= 0.5
