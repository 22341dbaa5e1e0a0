"""The end of a morph against the target's mesh itself, which no method has been given points of.

Random points and a lattice of random offset stand for the volume, so that a method whose
destinations come from the target's lattice has no advantage.
"""

from __future__ import annotations

import igl
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.point_cloud import Points, finite_points
from morph_engine.geometry.surface_reconstruction import Surface, deviations
from morph_engine.geometry.winding_number import inside
from morph_engine.metrics.body import body_surface
from morph_engine.metrics.chamfer import COVERING_RADIUS_OVER_H

DENSITY_SAMPLES = 10_000
"""Places at which the density is taken."""

LEVEL_SAMPLES = 40_000
"""Random points whose distance to the body's surface is taken, which is slow."""


def mesh_metrics(
    positions: npt.ArrayLike,
    mesh: Mesh,
    spacing: float,
    *,
    sample_count: int = 100_000,
    seed: int = 0,
) -> dict[str, float]:
    """How well particles fill a mesh, by random points of its volume.

    Args:
        positions: Particle positions [dx], shape [n, 3].
        mesh: Target mesh in grid units.
        spacing: Lattice spacing h [dx].
        sample_count: Number of random points inside the mesh.
        seed: Of the random points and the lattice's offset.

    Returns:
        ``dense_t2s`` [dx]: rms distance from a point of the mesh to the nearest particle;
        ``dense_floor`` [dx]: the same for as many particles on a cubic lattice that fills the
        mesh's volume, (V / n)^(1/3) / 2; ``covered``: share of points that are within 0.87 h of a
        particle; ``mesh_iou``: volume overlap of body and mesh; ``mesh_iou_level``: the same after
        the body is shrunk or grown evenly to the mesh's volume; ``density_p05`` and
        ``density_p95``: quantiles, over points of the mesh, of the number of particles within dx
        over that of an even fill.
    """
    rng = np.random.default_rng(seed)
    points, _ = finite_points(positions)
    tree = scipy.spatial.cKDTree(points)
    radius = COVERING_RADIUS_OVER_H * spacing

    lower = np.minimum(mesh.bounds[0], points.min(axis=0) - radius)
    upper = np.maximum(mesh.bounds[1], points.max(axis=0) + radius)
    samples, wanted = _random_points(mesh, lower, upper, sample_count, rng)
    distance, _ = tree.query(samples, distance_upper_bound=2 * radius)
    alone = wanted & np.isinf(distance)
    distance[alone], _ = tree.query(samples[alone])
    filled = distance < radius
    volume = np.prod(upper - lower) * wanted.mean()

    density = np.quantile(_density(tree, samples[wanted], mesh, spacing, rng), [0.05, 0.95])
    some = rng.permutation(np.flatnonzero(wanted | (distance < 2 * radius)))[:LEVEL_SAMPLES]
    level = _of_volume(points, spacing, samples[some], filled[some], int(wanted[some].sum()))
    return {
        "dense_t2s": float(np.sqrt(np.mean(distance[wanted] ** 2))),
        "dense_floor": float(np.cbrt(volume / len(points)) / 2),
        "covered": float(filled[wanted].mean()),
        "mesh_iou": _overlap(filled, wanted),
        "mesh_iou_level": _overlap(level, wanted[some]),
        "density_p05": float(density[0]),
        "density_p95": float(density[1]),
    }


def surface_metrics(surface: Surface, mesh: Mesh) -> dict[str, float]:
    """How far a reconstructed surface is off the mesh, over points spread evenly on both.

    Returns:
        ``surface_mean`` and ``surface_p95`` [dx]: mean and 95 % quantile of the distance to the
        other surface, the larger of both directions; ``normal_mean`` [degrees]: mean angle between
        the normals at a point and at the nearest one, over both directions.
    """
    (there, turned), (back, turned_back) = deviations(surface, mesh)
    return {
        "surface_mean": max(float(there.mean()), float(back.mean())),
        "surface_p95": max(float(np.quantile(distance, 0.95)) for distance in (there, back)),
        "normal_mean": float((turned.mean() + turned_back.mean()) / 2),
    }


def _random_points(
    mesh: Mesh, lower: Points, upper: Points, count: int, rng: np.random.Generator
) -> tuple[Points, npt.NDArray[np.bool_]]:
    """Random points of a box, `count` or a few more of them inside the mesh, and which are."""
    samples, wanted = np.empty((0, 3)), np.empty(0, bool)
    while (found := np.count_nonzero(wanted)) < count:
        share = max(found / max(len(wanted), 1), 0.02) if len(wanted) else 0.2
        more = rng.uniform(lower, upper, (int((count - found) / share * 1.02) + 1, 3))
        samples = np.concatenate([samples, more])
        wanted = np.concatenate([wanted, inside(mesh, more)])
    return samples, wanted


def _density(
    particles: scipy.spatial.cKDTree,
    inner: Points,
    mesh: Mesh,
    spacing: float,
    rng: np.random.Generator,
) -> Points:
    """Particles within dx of inner points of the mesh, over those of an even fill [ratio].

    A lattice of random offset and half the spacing tells how many an even fill has.
    """
    lower, upper = mesh.bounds
    first = lower - rng.random(3) * spacing / 2
    axes = [np.arange(a, b, spacing / 2) for a, b in zip(first, upper, strict=True)]
    box = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = box[inside(mesh, box)]
    here, even = (
        tree.query_ball_point(inner[:DENSITY_SAMPLES], 1.0, return_length=True)
        for tree in (particles, scipy.spatial.cKDTree(lattice))
    )
    ratio: Points = here / even * (len(lattice) / particles.n)
    return ratio


def _overlap(a: npt.NDArray[np.bool_], b: npt.NDArray[np.bool_]) -> float:
    return float(np.count_nonzero(a & b) / np.count_nonzero(a | b))


def _of_volume(
    points: Points, spacing: float, samples: Points, filled: npt.NDArray[np.bool_], count: int
) -> npt.NDArray[np.bool_]:
    """Samples in the body that is shrunk or grown evenly until it holds `count` of them."""
    vertices, faces = body_surface(points, spacing)
    squared, _, _ = igl.point_mesh_squared_distance(samples, vertices, faces.astype(np.int64))
    depth = np.where(filled, -1, 1) * np.sqrt(squared)
    within: npt.NDArray[np.bool_] = depth <= np.partition(depth, count - 1)[count - 1]
    return within
