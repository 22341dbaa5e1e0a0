"""A reconstructed surface drawn to a mesh that it is near to.

Particles show a shape no finer than their spacing. Where they rest in a shape whose mesh is known,
the mesh has the details.
"""

from __future__ import annotations

import igl
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.surface_reconstruction import Surface

Floats = npt.NDArray[np.float64]

REACH_OVER_H = 1.0
"""Vertices farther from the mesh than this many spacings stay where they are, so that what is
missing, or too much, is still to be seen; those nearer than half of it go all the way."""

ADHERENCE = 0.3
"""Weight of a vertex's own nearest point against planes through those of its neighbours. At 0.1
triangles fold 3 to 15 times as often; at 1 a cube's corner is missed by 0.5 h, not 0.3 h."""

TURNED = 0.3
"""Cosine of the angle that a triangle may turn by. At the corners of a cube it is 0.58; triangles
fold where the mesh has two sheets, as at a rim or a lid, and neighbours are drawn to either."""

RINGS = 2
"""How far around what has turned too much the moves are smoothed [edges]."""

ROUNDS = 4
"""Times that is done, at most: it may turn what is beside."""

SWEEPS = 30
"""Averages with the neighbours in a round."""


def snapped_to(surface: Surface, mesh: Mesh, share: float, spacing: float) -> Surface:
    """Move the vertices of a surface towards a mesh, and to its edges and corners.

    Args:
        surface: The surface [dx].
        mesh: The mesh [dx], which may be open.
        share: Part of the way to the mesh that vertices near it go, 0 to 1; it falls to 0 from half
            a spacing to a whole one.
        spacing: Lattice spacing h of the particles [dx].

    Returns:
        The surface with the same faces, as closed as it was.
    """
    triangles = mesh.faces.astype(np.int64)
    squared, face, nearest = igl.point_mesh_squared_distance(
        surface.vertices, mesh.vertices, triangles
    )
    near = np.clip(2 - 2 * np.sqrt(squared) / (REACH_OVER_H * spacing), 0, 1)
    normals = igl.per_face_normals(mesh.vertices, triangles, np.zeros(3))[face]
    neighbors = _neighbors(surface.faces, len(nearest))
    goals = _where_planes_meet(nearest, normals, near, neighbors)
    _, _, goals = igl.point_mesh_squared_distance(goals, mesh.vertices, triangles)
    moves = _unfolded(surface, near[:, None] * (goals - surface.vertices), neighbors)
    return Surface(surface.vertices + share * moves, surface.faces)


def _unfolded(surface: Surface, moves: Floats, neighbors: scipy.sparse.csr_array) -> Floats:
    """Moves of the vertices [dx], shape [V, 3], but smooth where they would fold the surface."""
    moves = moves.copy()
    degree = neighbors.sum(axis=1)
    faces = surface.faces.astype(np.int64)
    before = igl.per_face_normals(surface.vertices, faces, np.zeros(3))
    smooth = np.zeros(len(moves), bool)
    for _ in range(ROUNDS):
        after = igl.per_face_normals(surface.vertices + moves, faces, np.zeros(3))
        turned = np.einsum("fi,fi->f", before, after) < TURNED
        if not turned.any():
            break
        around = np.zeros(len(moves), bool)
        around[faces[turned]] = True
        for _ in range(RINGS):
            around |= neighbors @ around > 0
        smooth |= around
        rows = neighbors[smooth]
        for _ in range(SWEEPS):
            moves[smooth] = (rows @ moves) / degree[smooth, None]
    return moves


def _where_planes_meet(
    points: Floats, normals: Floats, weights: Floats, neighbors: scipy.sparse.csr_array
) -> Floats:
    """The point nearest to the planes of each vertex and its neighbours: on an edge where two meet.

    It has the least quadric error (Garland and Heckbert, "Surface simplification using quadric
    error metrics", 1997).

    Args:
        points: A point of the plane of each vertex [dx], shape [V, 3].
        normals: Its unit normal, shape [V, 3].
        weights: Its weight, shape [V].
        neighbors: 1 for each two vertices that are neighbours, shape [V, V].
    """
    count = len(points)
    ring = neighbors + scipy.sparse.eye_array(count, format="csr")
    outer = weights[:, None, None] * normals[:, :, None] * normals[:, None, :]
    matrix = (ring @ outer.reshape(count, 9)).reshape(count, 3, 3) + ADHERENCE * np.eye(3)
    right = ring @ np.einsum("vij,vj->vi", outer, points) + ADHERENCE * points
    met: Floats = np.linalg.solve(matrix, right[..., None])[..., 0]
    return met


def _neighbors(faces: npt.NDArray[np.int32], count: int) -> scipy.sparse.csr_array:
    """1 for each two of so many vertices that an edge joins, shape [V, V]."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    edges = scipy.sparse.coo_array((np.ones(len(start)), (start, end)), shape=(count, count))
    return edges.tocsr()
