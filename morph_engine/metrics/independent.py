"""The end of a morph against the target's mesh itself, which no method has been given points of.

Random points and a lattice of random offset and turn stand for the volume, so that a method whose
destinations come from the target's lattice has no advantage.
"""

from __future__ import annotations

import copy
import math
from functools import cached_property
from itertools import product

import igl
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.point_cloud import Points, finite_points
from morph_engine.geometry.surface_reconstruction import (
    SAMPLES,
    Surface,
    deviations,
    near_the_middle,
)
from morph_engine.geometry.winding_number import inside
from morph_engine.metrics.body import body_surface
from morph_engine.metrics.chamfer import COVERING_RADIUS_OVER_H

SUBCELLS = 8
"""Parts of a raster cell along each axis, by which its share in a ball is taken."""

LEVEL_SAMPLES = 40_000
"""Random points whose distance to the body's surface is taken, unless more are asked for."""

MOST_MESH_BOXES = 16
"""Volume of a box around mesh and body, over that of the mesh's own box, beyond which points are
drawn only near particles."""

AROUND = np.array(list(product((-1, 0, 1), repeat=3)))
"""Offsets from a cell to itself and its 26 neighbours."""


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
        if not len(points):
            return {
                "dense_t2s": math.inf,
                "dense_floor": math.inf,
                "dense_s2t": math.inf,
                "dense_s2t_floor": self.floor,
                "covered": 0.0,
                "mesh_iou": 0.0,
                "mesh_iou_level": 0.0,
                "density_p05": 0.0,
                "density_p95": 0.0,
            }
        tree = scipy.spatial.cKDTree(points)
        radius = COVERING_RADIUS_OVER_H * spacing
        body = near_the_middle(points, spacing)
        samples, wanted = self._with_those_beyond(body, radius, rng)
        distance, _ = tree.query(samples, distance_upper_bound=2 * radius)
        alone = wanted & np.isinf(distance)
        distance[alone], _ = tree.query(samples[alone])
        filled = distance < radius
        density = np.quantile(self._density(tree), [0.05, 0.95])
        return {
            "dense_t2s": _rms(distance[wanted]),
            "dense_floor": self.spacing(len(points)) / 2,
            "dense_s2t": self.distance_to_mesh(points),
            "dense_s2t_floor": self.floor,
            "covered": float(filled[wanted].mean()),
            "mesh_iou": _overlap(filled, wanted),
            "mesh_iou_level": self._level_overlap(body, spacing, samples, wanted, distance, rng),
            "density_p05": float(density[0]),
            "density_p95": float(density[1]),
        }

    def _level_overlap(
        self,
        body: Points,
        spacing: float,
        samples: Points,
        wanted: npt.NDArray[np.bool_],
        distance: Points,
        rng: np.random.Generator,
    ) -> float:
        """Overlap with the mesh after the body is shrunk or grown evenly to the mesh's volume.

        Samples that reach no farther than the body are enough where it shrinks. Where it grows, it
        may grow out of them, so they are drawn anew, each time twice as far beyond the body.

        Args:
            body: Particles [dx], shape [n, 3].
            spacing: Lattice spacing h [dx].
            samples: Points around mesh and body [dx], shape [k, 3].
            wanted: Those that are inside the mesh, shape [k].
            distance: To the nearest particle where that is within twice the radius [dx], shape [k].
            rng: Of further samples.
        """
        surface = body_surface(body, spacing)
        if not len(surface[1]):
            return 0.0
        tree = scipy.spatial.cKDTree(body)
        radius = COVERING_RADIUS_OVER_H * spacing
        beyond = 0.0  # how far the samples surround the body
        while True:
            near = distance < radius + max(beyond, radius)
            some = rng.permutation(np.flatnonzero(wanted | near))[: self._level_samples]
            depth = _depth(samples[some], distance[some] < radius, surface)
            count = np.count_nonzero(wanted[some])
            offset = np.partition(depth, count - 1)[count - 1]
            if offset <= beyond:
                return _overlap(depth <= offset, wanted[some])
            beyond = max(2 * beyond, radius)
            samples, wanted = self._with_those_beyond(body, radius + beyond, rng)
            distance, _ = tree.query(samples, distance_upper_bound=radius + beyond)

    def _with_those_beyond(
        self, points: Points, reach: float, rng: np.random.Generator
    ) -> tuple[Points, npt.NDArray[np.bool_]]:
        """Points drawn as densely within a reach of particles, and which are inside the mesh."""
        if not len(points):
            return self._samples, self._wanted
        low, high = self._bounds
        lower = np.minimum(low, points.min(axis=0) - reach)[None]
        upper = np.maximum(high, points.max(axis=0) + reach)[None]
        of_mesh = np.prod(high - low)
        if np.prod(upper - lower) > MOST_MESH_BOXES * of_mesh:
            lower = _cells_around(points, reach)
            upper = lower + reach
        count = round(len(self._samples) * np.prod(upper - lower, axis=1).sum() / of_mesh)
        which = np.arange(count) % len(lower)
        more = rng.uniform(lower[which], upper[which])
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
        even fill. With no finite particle distances are inf and the others 0. Particles far beyond
        the others are not in the body.

    Raises:
        MeshError: The positions have the wrong shape.
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


def _cells_around(points: Points, edge: float) -> Points:
    """Low corners of all cells of an edge that hold something within that edge of a point."""
    corner = points.min(axis=0)
    own = np.unique(np.floor((points - corner) / edge).astype(np.int64), axis=0)
    cells = np.unique((own[:, None] + AROUND).reshape(-1, 3), axis=0)
    corners: Points = corner + cells * edge
    return corners


def _depth(
    samples: Points,
    filled: npt.NDArray[np.bool_],
    surface: tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]],
) -> Points:
    """Distance of samples from a body's surface [dx], negative where they are inside."""
    vertices, faces = surface
    squared, _, _ = igl.point_mesh_squared_distance(samples, vertices, faces.astype(np.int64))
    depth: Points = np.where(filled, -1, 1) * np.sqrt(squared)
    return depth
