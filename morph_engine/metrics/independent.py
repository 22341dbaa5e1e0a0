"""The end of a morph against the target's mesh itself, which no method has been given points of.

Random points and a lattice of random offset and turn stand for the volume, so that a method whose
destinations come from the target's lattice has no advantage.
"""

from __future__ import annotations

import copy
from functools import cached_property

import igl
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.point_cloud import Points, finite_points
from morph_engine.geometry.surface_reconstruction import SAMPLES, Surface, deviations
from morph_engine.geometry.winding_number import inside
from morph_engine.metrics.body import body_surface
from morph_engine.metrics.chamfer import COVERING_RADIUS_OVER_H

SUBCELLS = 8
"""Parts of a raster cell along each axis, by which its share in a ball is taken."""

LEVEL_SAMPLES = 40_000
"""Random points whose distance to the body's surface is taken, unless more are asked for."""


class Reference:
    """Points that stand for a mesh's volume, drawn by a seed, and what particles measure by them.

    Args:
        mesh: Target mesh in grid units.
        count: Number of random points inside the mesh, and about that of the lattice.
        seed: Of the random points and the lattice's offset.
        sets: Sets of so many points that `dense_s2t` is taken over: particles in heaps have few
            places, each of which is as far from a single set as chance has it.
        level_samples: Most random points that `mesh_iou_level` is taken over, which is slow.

    Attributes:
        points: Random points of the volume [dx], shape [count or a few more, 3].
        lattice: Points of a lattice of random offset and turn in it [dx], about as many.
        volume: Of the mesh, by the random points [dx^3].
    """

    def __init__(
        self,
        mesh: Mesh,
        *,
        count: int = 100_000,
        seed: int = 0,
        sets: int = 1,
        level_samples: int = LEVEL_SAMPLES,
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._bounds = mesh.bounds
        self._level_samples = level_samples
        self._samples, self._wanted = _random_points(mesh, count, self._rng)
        self.points: Points = self._samples[self._wanted]
        self.volume: float = float(np.prod(mesh.bounds[1] - mesh.bounds[0]) * self._wanted.mean())
        self._tree = scipy.spatial.cKDTree(self.points)
        more = (_random_points(mesh, count, self._rng) for _ in range(sets - 1))
        self._sets = [self._tree, *(scipy.spatial.cKDTree(of[wanted]) for of, wanted in more)]
        step = float(np.cbrt(self.volume / count))
        self.lattice: Points
        self.lattice, self._even = _lattice(mesh, step, self._rng)

    @cached_property
    def floor(self) -> float:
        """Rms distance from one of the random points to the nearest other one [dx]."""
        apart, _ = self._tree.query(self.points, k=2)
        return _rms(apart[:, 1])

    def spacing(self, count: int) -> float:
        """Spacing of so many particles on a cubic lattice that fills the volume [dx]."""
        return float(np.cbrt(self.volume / count))

    def distance_to_mesh(self, positions: npt.ArrayLike) -> float:
        """Rms distance from a particle to the nearest random point [dx], over all sets."""
        points, _ = finite_points(positions)
        return _rms(np.stack([each.query(points)[0] for each in self._sets]))

    def measure(self, positions: npt.ArrayLike, spacing: float) -> dict[str, float]:
        """What `mesh_metrics` returns, of particles of a spacing [dx]; always by the same draw."""
        rng = copy.deepcopy(self._rng)
        points, _ = finite_points(positions)
        tree = scipy.spatial.cKDTree(points)
        radius = COVERING_RADIUS_OVER_H * spacing
        samples, wanted = self._with_those_beyond(points, radius, rng)
        distance, _ = tree.query(samples, distance_upper_bound=2 * radius)
        alone = wanted & np.isinf(distance)
        distance[alone], _ = tree.query(samples[alone])
        filled = distance < radius

        some = rng.permutation(np.flatnonzero(wanted | (distance < 2 * radius)))
        some = some[: self._level_samples]
        level = _of_volume(points, spacing, samples[some], filled[some], int(wanted[some].sum()))
        density = np.quantile(self._density(tree), [0.05, 0.95])
        return {
            "dense_t2s": _rms(distance[wanted]),
            "dense_floor": self.spacing(len(points)) / 2,
            "dense_s2t": self.distance_to_mesh(points),
            "dense_s2t_floor": self.floor,
            "covered": float(filled[wanted].mean()),
            "mesh_iou": _overlap(filled, wanted),
            "mesh_iou_level": _overlap(level, wanted[some]),
            "density_p05": float(density[0]),
            "density_p95": float(density[1]),
        }

    def _with_those_beyond(
        self, points: Points, radius: float, rng: np.random.Generator
    ) -> tuple[Points, npt.NDArray[np.bool_]]:
        """Points drawn as densely wherever a particle reaches, and which are inside the mesh."""
        low, high = self._bounds
        lower = np.minimum(low, points.min(axis=0) - radius)
        upper = np.maximum(high, points.max(axis=0) + radius)
        count = round(len(self._samples) * np.prod(upper - lower) / np.prod(high - low))
        more = rng.uniform(lower, upper, (count, 3))
        more = more[((more < low) | (more > high)).any(axis=1)]
        return (
            np.concatenate([self._samples, more]),
            np.concatenate([self._wanted, np.zeros(len(more), bool)]),
        )

    def _density(self, particles: scipy.spatial.cKDTree) -> Points:
        """Particles within dx of points of the lattice, over those of an even fill [ratio].

        Places come from a lattice, since quantiles over as many random ones move more.
        """
        here = particles.query_ball_point(self.lattice, 1.0, return_length=True)
        ratio: Points = here / self._even * (len(self.lattice) / particles.n)
        return ratio


def mesh_metrics(
    positions: npt.ArrayLike,
    mesh: Mesh,
    spacing: float,
    *,
    sample_count: int = 100_000,
    seed: int = 0,
) -> dict[str, float]:
    """How well particles fill a mesh, by points of its volume.

    Args:
        positions: Particle positions [dx], shape [n, 3].
        mesh: Target mesh in grid units.
        spacing: Lattice spacing h [dx].
        sample_count: Number of random points inside the mesh.
        seed: Of the random points and the lattice's offset.

    Returns:
        ``dense_t2s`` [dx]: rms distance from a point of the mesh to the nearest particle;
        ``dense_floor`` [dx]: the same for as many particles on a cubic lattice that fills the
        mesh's volume, (V / n)^(1/3) / 2; ``dense_s2t`` [dx]: rms distance from a particle to the
        nearest point of the mesh; ``dense_s2t_floor`` [dx]: the same for particles at random places
        inside the mesh; ``covered``: share of points that are within 0.87 h of a particle;
        ``mesh_iou``: volume overlap of body and mesh; ``mesh_iou_level``: the same after the body
        is shrunk or grown evenly to the mesh's volume; ``density_p05`` and ``density_p95``:
        quantiles, over a lattice in the mesh, of the number of particles within dx over that of an
        even fill.
    """
    return Reference(mesh, count=sample_count, seed=seed).measure(positions, spacing)


def surface_metrics(
    surface: Surface, mesh: Mesh, *, sample_count: int = SAMPLES, seed: int = 0
) -> dict[str, float]:
    """How far a reconstructed surface is off the mesh, over random points spread evenly on both.

    Returns:
        ``surface_mean`` and ``surface_p95`` [dx]: mean and 95 % quantile of the distance to the
        other surface, the larger of both directions; ``normal_mean`` [degrees]: mean angle between
        the normals at a point and at the nearest one, over both directions.
    """
    (there, turned), (back, turned_back) = deviations(surface, mesh, count=sample_count, seed=seed)
    return {
        "surface_mean": max(float(there.mean()), float(back.mean())),
        "surface_p95": max(float(np.quantile(distance, 0.95)) for distance in (there, back)),
        "normal_mean": float((turned.mean() + turned_back.mean()) / 2),
    }


def _random_points(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> tuple[Points, npt.NDArray[np.bool_]]:
    """Random points of a mesh's box, `count` or a few more of them inside, and which are."""
    lower, upper = mesh.bounds
    samples, wanted = np.empty((0, 3)), np.empty(0, bool)
    while (found := np.count_nonzero(wanted)) < count:
        share = max(found / len(wanted), 0.02) if len(wanted) else 1.0
        more = rng.uniform(lower, upper, (int((count - found) / share * 1.02) + 1, 3))
        samples = np.concatenate([samples, more])
        wanted = np.concatenate([wanted, inside(mesh, more)])
    return samples, wanted


def _lattice(mesh: Mesh, step: float, rng: np.random.Generator) -> tuple[Points, Points]:
    """A lattice of random offset and turn in a mesh, and how much of it is within dx of each point.

    It is turned so that a flat face of the mesh does not take or leave a whole layer. Of a point at
    the rim of the ball counts the part of its cell that the ball has, so that inside the mesh it is
    the ball's volume in cells.
    """
    turn = scipy.spatial.transform.Rotation.random(random_state=rng).as_matrix()
    turned = mesh.vertices @ turn
    lower, upper = turned.min(axis=0), turned.max(axis=0)
    first = lower - rng.random(3) * step
    axes = [np.arange(a, b + step, step) for a, b in zip(first, upper, strict=True)]
    box = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) @ turn.T
    kept = inside(mesh, box.reshape(-1, 3)).reshape(box.shape[:3])
    within: Points = scipy.signal.fftconvolve(kept.astype(float), _ball(step), mode="same")
    return box[kept], within[kept]


def _ball(step: float) -> Points:
    """Share of each cell of a raster that is within dx of the middle of the central one."""
    reach = int(1 / step + 0.5)
    fine = (np.arange((2 * reach + 1) * SUBCELLS) + 0.5) / SUBCELLS - reach - 0.5  # in cells
    square = (fine * step) ** 2
    is_within = square[:, None, None] + square[:, None] + square <= 1
    cells = is_within.reshape((2 * reach + 1, SUBCELLS) * 3)
    share: Points = cells.mean(axis=(1, 3, 5))
    return share


def _rms(values: Points) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
