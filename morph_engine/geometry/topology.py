"""How the triangles of a mesh hang together: parts, Euler number, openings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt
import scipy

igl: Any = lazy.load("igl")

WELD_TOLERANCE = 1e-6
"""Vertices closer than this share of the mesh's size count as one (STL stores each face apart)."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Opening:
    """A connected set of edges along which a surface is open, and their bounding box."""

    edge_count: int
    centre: Vector
    size: Vector


class Topology:
    """Connectivity of a triangle mesh after welding equal positions.

    Attributes:
        points: Vertices that are distinct, shape [v, 3], float64.
        faces: Indices of them, shape [f, 3], int64, without faces that have become a line.
        kept: Index of each of these faces in the mesh, shape [f].
        disagree: Two faces that meet at an edge look to different sides.
        watertight: Every edge joins exactly two faces, and their orientations agree.
        open_edges: Edges passed more often in one direction than in the other, shape [e, 2], int64.
    """

    def __init__(self, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int32]) -> None:
        lower = vertices.min(axis=0)
        size = float(np.linalg.norm(np.ptp(vertices, axis=0))) or 1.0  # all at one point
        cells = np.rint((vertices - lower) / (WELD_TOLERANCE * size)).astype(np.int64)
        _, first, welded = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        self.points = vertices[first]
        corners = welded.reshape(-1)[faces]
        self.kept = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
        self.faces = corners[self.kept]

        directed = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        edges, edge_of, uses = np.unique(
            np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
        )
        forward = np.where(directed[:, 0] < directed[:, 1], 1, -1)
        balance = np.bincount(edge_of.reshape(-1), weights=forward, minlength=len(edges))
        self.open_edges: npt.NDArray[np.intp] = edges[balance != 0]
        self.disagree: bool = bool(((uses == 2) & (balance != 0)).any())
        self.watertight: bool = bool(((uses == 2) & (balance == 0)).all())

        self._edges = edges

    @cached_property
    def _parts(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
        return _components(self._edges)

    @cached_property
    def component_count(self) -> int:
        """Number of parts that share no vertex."""
        return int(self._parts[1].max(initial=-1)) + 1

    @cached_property
    def euler(self) -> int:
        """Vertices - edges + faces."""
        return len(self._parts[0]) - len(self._edges) + len(self.faces)

    @cached_property
    def component_volumes(self) -> npt.NDArray[Any]:
        """Signed volume of each part, shape [component_count]."""
        used, labels = self._parts
        part = labels[np.searchsorted(used, self.faces[:, 0])]
        volumes: npt.NDArray[Any] = np.bincount(
            part, weights=face_volumes(self.points, self.faces), minlength=self.component_count
        )
        return volumes

    @cached_property
    def openings(self) -> tuple[Opening, ...]:
        """Connected sets of open edges, the longest first."""
        used, labels = _components(self.open_edges)
        part = labels[np.searchsorted(used, self.open_edges[:, 0])]
        ends = self.points[self.open_edges]
        length = np.bincount(part, weights=np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
        return tuple(_opening(ends[part == label]) for label in np.argsort(-length))


def signed_volume(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int32]) -> float:
    """Signed volume under a triangle soup; overlapping parts count twice."""
    return float(face_volumes(vertices, faces).sum())


def triangle_areas(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.integer]
) -> npt.NDArray[np.float64]:
    """Area of each triangle, shape [f], float64."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    areas: npt.NDArray[np.float64] = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


def vertex_normals(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.integer]
) -> npt.NDArray[np.float64]:
    """Unit normals at the corners, each the mean of its faces by area, shape [v, 3], float64.

    They are 0 where no face has an area.
    """
    by_area = igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_AREA
    normals = igl.per_vertex_normals(vertices, faces.astype(np.int64), by_area)
    return np.where(np.isnan(normals), 0, normals)


def face_volumes(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.integer]
) -> npt.NDArray[np.float64]:
    """Signed volume of the tetrahedra between each face and the centre of the bounding box."""
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    a, b, c = np.moveaxis((vertices - centre)[faces], 1, 0)
    volumes: npt.NDArray[np.float64] = np.einsum("fi,fi->f", a, np.cross(b, c)) / 6
    return volumes


def _components(
    edges: npt.NDArray[np.int64],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
    """Vertices of a graph in ascending order, and the component that each belongs to."""
    used, ends = np.unique(edges, return_inverse=True)
    a, b = ends.reshape(-1, 2).T
    graph = scipy.sparse.coo_array((np.ones(len(a)), (a, b)), shape=(len(used), len(used)))
    return used, scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def _opening(ends: npt.NDArray[np.float64]) -> Opening:
    points = ends.reshape(-1, 3)
    lower, upper = points.min(axis=0), points.max(axis=0)
    return Opening(
        len(ends), tuple(((lower + upper) / 2).tolist()), tuple((upper - lower).tolist())
    )
