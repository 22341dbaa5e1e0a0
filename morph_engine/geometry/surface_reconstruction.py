"""Surfaces: a closed triangle mesh around the particles of one frame.

Each particle carries an SPH colour of 1, and the surface is where their interpolation falls to
`ISO_LEVEL`. pysplashsurf builds it and smooths it with weights that leave isolated particles alone
(Loeschner et al., "Weighted Laplacian Smoothing for Surface Reconstruction of Particle-based
Fluids", 2023).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
import numpy.typing as npt
import pysplashsurf
import scipy
import trimesh
from scipy.spatial import cKDTree

from morph_engine.distinct import distinct
from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.point_cloud import Points, finite_points
from morph_engine.geometry.topology import signed_volume, triangle_areas, vertex_normals

KERNEL_OVER_H = 2.5
"""Reach of the kernel over the lattice spacing. At 2, a fill of uneven density tears into splinters
and bubbles; at 3, fine parts grow together, and it takes twice as long."""

CELL_OVER_H = 0.375
"""Edge of a marching cube over the lattice spacing: some 40 000 vertices for 37 000 particles."""

COARSE_CELL_OVER_H = 0.5
"""Edge of a marching cube where only the topology counts."""

ISO_LEVEL = 0.63
"""Colour at the surface, chosen so that the surface of a sphere's even lattice encloses the
sphere's own volume; `docs/exports.md` has the measurements."""

SMOOTHING = 10
"""Steps of smoothing: enough to hide the lattice, few enough to keep edges, which shrink."""

REACH_OVER_H = 1e4
"""Particles farther than this many spacings from the middle of all have escaped."""

SAMPLES = 20_000
"""Points that stand for a surface where two are compared."""


Deviation = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh, counter-clockwise seen from outside.

    Attributes:
        vertices: Corner positions [dx], shape [V, 3], float64; those of
            `reconstruct_surface` are float32 numbers.
        faces: Vertex indices, shape [F, 3], int32.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]

    @cached_property
    def normals(self) -> npt.NDArray[np.float64]:
        """Unit normals at the vertices, shape [V, 3], float64."""
        return vertex_normals(self.vertices, self.faces)

    @cached_property
    def vertex_tree(self) -> cKDTree:
        """A search tree over the vertices."""
        return cKDTree(self.vertices)

    @cached_property
    def watertight(self) -> bool:
        """Whether every edge joins exactly two faces whose orientations agree."""
        start = self.faces.astype(np.int64)
        end = np.roll(start, -1, axis=1)
        there = distinct(start * len(self.vertices) + end)
        back = distinct(end * len(self.vertices) + start)
        return len(there) == start.size and np.array_equal(there, back)

    @property
    def bodies(self) -> int:
        """Number of parts that share no vertex; the wall of an inner cavity is one."""
        return len(self.part_areas)

    @property
    def euler(self) -> int:
        """Vertices - edges + faces of a watertight surface, whose faces have 3/2 edges each."""
        return len(distinct(self.faces)) - len(self.faces) // 2

    @property
    def area_share_of_largest(self) -> float:
        """Area of the largest part over that of all."""
        return float(self.part_areas.max() / self.part_areas.sum())

    @property
    def volume(self) -> float:
        """Enclosed volume [dx^3]."""
        return signed_volume(self.vertices, self.faces)

    @cached_property
    def part_of_face(self) -> npt.NDArray[np.intp]:
        """Index of the part each face belongs to, shape [F]."""
        start, end = self.faces.reshape(-1), np.roll(self.faces, -1, axis=1).reshape(-1)
        count = len(self.vertices)
        graph = scipy.sparse.coo_array(
            (np.ones(len(start), np.int8), (start, end)), shape=(count, count)
        )
        part_of_vertex = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
        part: npt.NDArray[np.intp] = np.unique(
            part_of_vertex[self.faces[:, 0]], return_inverse=True
        )[1]
        return part

    @cached_property
    def part_areas(self) -> npt.NDArray[np.float64]:
        """Area of each part [dx^2], shape [bodies], float64."""
        areas = triangle_areas(self.vertices, self.faces)
        return np.bincount(self.part_of_face, weights=areas).astype(np.float64)


def reconstruct_surface(
    positions: npt.ArrayLike, spacing: float, *, cell_over_h: float = CELL_OVER_H
) -> Surface:
    """Reconstruct the surface of a fill.

    Args:
        positions: Particle positions [dx], shape [n, 3]. Those not finite, or far beyond the
            others, take no part.
        spacing: Lattice spacing h of the particles at rest [dx].
        cell_over_h: Edge of a marching cube over the spacing.

    Returns:
        The surface, which is watertight; the same to the bit for the same particles.

    Raises:
        MeshError: The positions have the wrong shape, or enclose nothing.
    """
    vertices, faces = _interpolated(positions, spacing, cell_over_h, SMOOTHING)
    # smoothing adds up in any order, which the last bits of float64 tell; float32 is without them
    vertices = vertices.astype(np.float32).astype(np.float64)
    return _without_specks(_in_order(vertices, faces), spacing**2)


def surface_euler(positions: npt.ArrayLike, spacing: float) -> int:
    """Euler number of the reconstructed surface, from coarser cells and without smoothing it.

    It is 2 for a ball and 0 for a torus; each further body or inner cavity adds 2, and each tunnel
    takes 2 away. Holes narrower than the kernel's reach do not count. Arguments and errors are
    those of `reconstruct_surface`, in a third of its time.
    """
    vertices, faces = _interpolated(positions, spacing, COARSE_CELL_OVER_H, 0)
    surface = _without_specks(Surface(vertices, faces.astype(np.int32)), spacing**2)
    return surface.euler


def near_the_middle(points: Points, spacing: float) -> Points:
    """The points that have not escaped: those near the median of all.

    Args:
        points: Finite positions [dx], shape [n, 3].
        spacing: Lattice spacing h [dx]; a point within 10^4 of it along each axis is near.

    Returns:
        The near ones [dx], shape [k, 3], in the same order.
    """
    return points[are_near_the_middle(points, spacing)]


def are_near_the_middle(points: Points, spacing: float) -> npt.NDArray[np.bool_]:
    """Which points have not escaped, shape [n]; arguments as for `near_the_middle`."""
    if not len(points):
        return np.zeros(0, np.bool_)
    from_middle = np.abs(points - np.median(points, axis=0))
    return np.asarray((from_middle < REACH_OVER_H * spacing).all(axis=1))


def surface_deviation(surface: Surface, target_mesh: Mesh) -> dict[str, float]:
    """How far a surface lies from that of the target [dx], and the other way round.

    Distances are from 20 000 points, spread evenly by area with a fixed seed, to the nearest point
    of any triangle of the other mesh. Where the target is open, its missing faces count as far.

    Returns:
        ``mean``, ``rms`` and ``max`` from the surface to the target, and ``mean_back``,
        ``rms_back`` and ``max_back`` from the target to the surface [dx].
    """
    there, back = deviations(surface, target_mesh)
    return _statistics(there[0]) | {
        f"{name}_back": value for name, value in _statistics(back[0]).items()
    }


def deviations(
    surface: Surface, target_mesh: Mesh, *, count: int = SAMPLES, seed: int = 0
) -> tuple[Deviation, Deviation]:
    """How far a surface is off at random points of it, and of the target's, spread by area.

    Returns:
        From the surface to the target, and back: distances to the nearest point of any triangle
        of the other mesh [dx], and angles between the two triangles' normals there [degrees], shape
        [count], float64 both.
    """
    ours, target = (surface.vertices, surface.faces), (target_mesh.vertices, target_mesh.faces)
    return _deviation(*ours, *target, count, seed), _deviation(*target, *ours, count, seed)


def _interpolated(
    positions: npt.ArrayLike, spacing: float, cell_over_h: float, smoothing: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.integer]]:
    """Vertices and faces where the colour of the particles falls to `ISO_LEVEL`, in any order."""
    points, _ = finite_points(positions)
    points = near_the_middle(points, spacing)
    if not len(points):
        raise MeshError(
            "There are no particles to compute a surface from.", "Choose another frame."
        )
    radius = spacing / 2
    found, _ = pysplashsurf.reconstruction_pipeline(
        np.ascontiguousarray(points),
        particle_radius=radius,
        smoothing_length=KERNEL_OVER_H,  # in radii, and the kernel reaches twice as far
        cube_size=cell_over_h * spacing / radius,
        iso_surface_threshold=ISO_LEVEL,
        mesh_cleanup=smoothing > 0,
        mesh_smoothing_iters=smoothing or None,
        mesh_smoothing_weights=smoothing > 0,
        multi_threading=False,  # with threads, no two runs give the same bits
    )
    faces = np.asarray(found.mesh.triangles)  # type: ignore[union-attr]
    return np.asarray(found.mesh.vertices, np.float64), faces


def _in_order(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.integer]) -> Surface:
    """Sort vertices, each face's corners and the faces, which are found in any order."""
    order = np.lexsort(vertices.T)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    corners = rank[faces]
    turns = (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turns, axis=1)
    return Surface(vertices[order], corners[np.lexsort(corners.T)])


def _without_specks(surface: Surface, least_area: float) -> Surface:
    """Drop parts that are too small for a particle: bubbles and splinters of the interpolation."""
    kept = np.zeros(0, bool)
    if len(surface.faces):
        kept = surface.part_areas[surface.part_of_face] >= least_area
    if not kept.any():
        raise MeshError("The particles enclose no volume.", "Choose another frame.")
    if kept.all():
        return surface
    used, faces = np.unique(surface.faces[kept], return_inverse=True)
    return Surface(surface.vertices[used], faces.reshape(-1, 3).astype(np.int32))


def _deviation(
    vertices: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int32],
    other_vertices: npt.NDArray[np.float64],
    other_faces: npt.NDArray[np.int32],
    count: int,
    seed: int,
) -> Deviation:
    shape = trimesh.Trimesh(vertices, faces, process=False)
    points, on = trimesh.sample.sample_surface(shape, count, seed=seed)
    squared, near, _ = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points, np.float64), other_vertices, other_faces.astype(np.int64)
    )
    normals, others = (
        igl.per_face_normals(corners, triangles.astype(np.int64), np.zeros(3))[on_these]
        for corners, triangles, on_these in (
            (vertices, faces, on),
            (other_vertices, other_faces, near),
        )
    )
    cosine = np.clip(np.einsum("pi,pi->p", normals, others), -1, 1)
    return np.sqrt(squared), np.degrees(np.arccos(cosine))


def _statistics(distance: npt.NDArray[np.float64]) -> dict[str, float]:
    return {
        "mean": float(distance.mean()),
        "rms": float(np.sqrt(np.mean(distance**2))),
        "max": float(distance.max()),
    }
