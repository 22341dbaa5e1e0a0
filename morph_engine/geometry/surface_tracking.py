"""A closed surface followed through a motion: one set of triangles, carried by the matter.

From frame to frame each vertex goes where the particles around it go, and is then drawn to the
surface reconstructed around the particles of that frame. Vertices slide along the surface, so that
triangles stay even where matter is stretched. Triangles that find no surface, as where two walls
have met, shrink like a soap film, which draws a pocket out to the surface and turns a handle
without matter into a thread. What tracking cannot do is change the topology.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy
from scipy.spatial import cKDTree

from morph_engine.errors import MeshError
from morph_engine.geometry.surface_reconstruction import Surface
from morph_engine.geometry.topology import vertex_normals

Floats = npt.NDArray[np.float64]

NEIGHBORS = 16
"""Particles that carry a vertex."""

CARRY_WIDTH_OVER_H = 1.5
"""Width of their Gaussian weights over the spacing."""

STIFFNESS_OVER_H = 0.3
"""Spread of the particles, over the spacing, below which their motion says nothing of a gradient:
the fit is then a shift."""

SLIDING = 0.3
"""Share of the way to the middle of its neighbours that a vertex slides along the surface, a step.
"""

STEPS = 4
"""Steps of sliding and drawing per frame where all vertices find the surface."""

MOST_STEPS = 8
"""The same where some do not, or triangles have folded over."""

CANDIDATES = 6
"""Nearest points of the surface that a vertex may belong to."""

FACING = 0.3
"""Least cosine between the normals of a vertex and of the point of the surface it is drawn to."""

FACING_FAR = 0.6
"""The same for points farther than `REACH_OVER_H`."""

REACH_OVER_H = 1.5
"""How far from its vertex over the spacing a point of the surface is near; the longest step."""

RINGS = 2
"""Rings of neighbours around vertices astray that are smoothed along with them."""

SMOOTHING = 10
"""Smoothing of those vertices per step."""


def carried(vertices: Floats, before: Floats, after: Floats, spacing: float) -> Floats:
    """Move vertices along with the matter: an affine motion each, fitted to particles around it.

    Moving least squares with weights that fall with the distance, shrunk towards a shift
    (Mueller et al., "Point based animation of elastic, plastic and melting objects", 2004).

    Args:
        vertices: Positions [dx], shape [V, 3].
        before: Positions of the particles in the same frame [dx], shape [n, 3].
        after: Where the same particles are in the other frame [dx], shape [n, 3].
        spacing: Lattice spacing h of the particles [dx].

    Returns:
        Positions in the other frame [dx], shape [V, 3]. Particles that are not finite in both
        frames carry nothing.

    Raises:
        MeshError: None is finite in both.
    """
    known = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    if not known.any():
        raise MeshError(
            "Two frames in a row have no particle in common.", "Export their surfaces untracked."
        )
    before, after = before[known], after[known]
    distance, near = cKDTree(before).query(vertices, k=min(NEIGHBORS, len(before)), workers=-1)
    distance, near = distance.reshape(len(vertices), -1), near.reshape(len(vertices), -1)
    closest = distance.min(axis=1, keepdims=True)
    weights = np.exp((closest**2 - distance**2) / (CARRY_WIDTH_OVER_H * spacing) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    here, there = before[near], after[near]
    middle_here, middle_there = (np.einsum("vk,vki->vi", weights, part) for part in (here, there))
    arm = here - middle_here[:, None]
    stretch = (there - middle_there[:, None]) - arm
    spread = np.einsum("vk,vki,vkj->vij", weights, arm, arm)
    spread += (STIFFNESS_OVER_H * spacing) ** 2 * np.eye(3)
    change = np.einsum("vk,vki,vkj->vij", weights, stretch, arm) @ np.linalg.inv(spread)
    own_arm = vertices - middle_here
    moved: Floats = middle_there + own_arm + np.einsum("vij,vj->vi", change, own_arm)
    return moved


class SurfaceTracker:
    """Draws a mesh of fixed triangles to one surface after the other.

    Args:
        faces: Vertex indices of the triangles, shape [F, 3], int32.
        count: Number of vertices V.
    """

    def __init__(self, faces: npt.NDArray[np.int32], count: int) -> None:
        start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
        both = np.concatenate([start, end]), np.concatenate([end, start])
        linked = scipy.sparse.coo_array((np.ones(len(both[0])), both), shape=(count, count))
        linked = (linked.tocsr() > 0).astype(np.float64)
        self._faces = faces
        self._around = linked + scipy.sparse.eye_array(count, format="csr")
        degree = np.maximum(linked.sum(axis=1), 1)
        self._middle = scipy.sparse.csr_array(scipy.sparse.diags_array(1 / degree) @ linked)

    def drawn(self, vertices: Floats, surface: Surface, spacing: float) -> Floats:
        """Draw vertices that are near to a surface to it.

        Args:
            vertices: Positions [dx], shape [V, 3].
            surface: The surface, whose edges are shorter than h.
            spacing: Lattice spacing h of the particles [dx].

        Returns:
            New positions [dx], shape [V, 3]. Vertices between walls that touch may stay inside.
        """
        for step in range(MOST_STEPS):
            vertices = self._slid(vertices)
            vertices, astray = self._stepped(vertices, surface, spacing)
            if not astray.any():
                if step + 1 >= STEPS:
                    break
            elif step + 1 < MOST_STEPS:  # the last word is the surface's
                vertices = self._smoothed(vertices, astray)
        return vertices

    def _slid(self, vertices: Floats) -> Floats:
        """Vertices moved towards the middle of their neighbours, but not along their normals."""
        normals = vertex_normals(vertices, self._faces)
        move = self._middle @ vertices - vertices
        move -= np.einsum("vi,vi->v", move, normals)[:, None] * normals
        slid: Floats = vertices + SLIDING * move
        return slid

    def _stepped(
        self, vertices: Floats, surface: Surface, spacing: float
    ) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Vertices drawn to the surface, and which of them do not find it or have folded over."""
        reach = REACH_OVER_H * spacing
        normals = vertex_normals(vertices, self._faces)
        _, nearest = surface.vertex_tree.query(vertices, workers=-1)
        facing = np.einsum("vi,vi->v", surface.normals[nearest], normals)
        goal, found = nearest.copy(), facing > FACING
        others = np.flatnonzero(~found)
        if len(others):
            _, near = surface.vertex_tree.query(vertices[others], k=CANDIDATES, workers=-1)
            fits = np.einsum("vki,vi->vk", surface.normals[near], normals[others]) > FACING
            first = fits.argmax(axis=1)[:, None]
            goal[others] = np.take_along_axis(near, first, axis=1)[:, 0]
            found[others] = fits.any(axis=1)
        offset, along = surface.vertices[goal] - vertices, surface.normals[goal]
        near_enough = np.linalg.norm(offset, axis=1) < reach
        found &= near_enough | (facing > FACING_FAR)
        step = np.clip(np.einsum("vi,vi->v", offset, along), -reach, reach)
        moved = vertices.copy()
        moved[found] += step[found, None] * along[found]
        a, b, c = np.moveaxis(moved[self._faces], 1, 0)
        outward = surface.normals[nearest[self._faces[:, 0]]]
        folded = np.einsum("fi,fi->f", np.cross(b - a, c - a), outward) < 0
        astray = ~found
        astray[self._faces[folded]] = True
        return moved, astray

    def _smoothed(self, vertices: Floats, astray: npt.NDArray[np.bool_]) -> Floats:
        """Vertices astray and those around them put in the middle of their neighbours.

        A pocket between walls that have met is so drawn out to where it opens, and folds unfold.
        """
        for _ in range(RINGS):
            astray = self._around @ astray > 0
        middle = self._middle[astray]
        for _ in range(SMOOTHING):
            vertices[astray] = middle @ vertices
        return vertices


def mean_distance(one: Surface, other: Surface) -> float:
    """How far two surfaces are apart [dx]: from faces to planes on average, in both directions.

    Faces count by the distance of their centres from the other surface.
    """
    return _mean_distance(one, other) + _mean_distance(other, one)


def _mean_distance(one: Surface, other: Surface) -> float:
    points = one.vertices[one.faces].mean(axis=1)
    a, b, c = np.moveaxis(one.vertices[one.faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    distance, near = other.vertex_tree.query(points, workers=-1)
    edge = np.linalg.norm(
        other.vertices[other.faces[:, 0]] - other.vertices[other.faces[:, 1]], axis=1
    )
    height = np.abs(np.einsum("vi,vi->v", points - other.vertices[near], other.normals[near]))
    far = np.where(distance > np.median(edge), distance, height)
    return float(np.average(far, weights=areas))
