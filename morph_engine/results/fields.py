"""Fields: one number per particle and frame, to colour particles by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.errors import ResultError, unknown_name
from morph_engine.geometry.point_cloud import (
    Points,
    distance_to_other,
    finite_points,
    target_points,
)

Values = npt.NDArray[np.float32]

DENSITY_RADIUS = 1.0
"""Radius of the ball in which the density of a particle is counted [dx]."""


@dataclass(frozen=True)
class FieldDefinition:
    """What one field means.

    Attributes:
        label: Its name for people.
        unit: ``dx`` (grid units), ``h`` (sample spacings), ``ratio`` or ``count``.
        meaning: What a value tells, in a few words.
        diverging: Whether 1 is the neutral value, with a meaning on either side.
    """

    label: str
    unit: str
    meaning: str
    diverging: bool = False


FIELDS: dict[str, FieldDefinition] = {
    "displacement": FieldDefinition(
        "Displacement", "dx", "how far the particle is from where it started"
    ),
    "speed": FieldDefinition(
        "Speed", "dx", "how far the particle has moved since the previous frame"
    ),
    "target_distance": FieldDefinition(
        "Distance to target", "dx", "how far the particle is from the nearest target point"
    ),
    "density": FieldDefinition(
        "Density",
        "ratio",
        "number of particles nearby relative to an even fill; above 1 is crowded, below "
        "1 is sparse",
        diverging=True,
    ),
    "target_hits": FieldDefinition(
        "Target hits",
        "count",
        "number of particles that share its nearest target point, including itself",
    ),
    "det_f": FieldDefinition(
        "Volume change",
        "ratio",
        "det F: volume relative to that at rest, as far as the grid moved the particle",
        diverging=True,
    ),
    "overlap": FieldDefinition(
        "Distance to neighbour", "h", "distance to the nearest other particle; 0 if they coincide"
    ),
}


def find(name: str) -> FieldDefinition:
    """A field by its name.

    Raises:
        ConfigError: There is no such field.
    """
    if name not in FIELDS:
        raise unknown_name("field", name, FIELDS)
    return FIELDS[name]


def field(
    name: str,
    *,
    positions: npt.ArrayLike,
    previous: npt.ArrayLike | None,
    source: npt.ArrayLike,
    target: npt.ArrayLike,
    det_f: npt.ArrayLike | None = None,
    spacing: float | None = None,
    workers: int = 1,
) -> Values:
    """Compute a field of one frame.

    Args:
        name: One of `FIELDS`.
        positions: Particle positions [dx], shape [n, 3].
        previous: Positions in the frame before [dx], shape [n, 3]; None for the first frame,
            which comes after the source.
        source: Positions before the first frame [dx], shape [n, 3].
        target: Target points [dx], shape [m, 3].
        det_f: det F of the particles [ratio], shape [n], where the method has it.
        spacing: Lattice spacing h of the target [dx]; None takes the usual distance of
            neighbouring target points.
        workers: Threads for the searches; -1 takes every core.

    Returns:
        A value per particle, shape [n], float32, in the unit of its definition; NaN for a particle
        with a coordinate that is not finite.

    Raises:
        ConfigError: There is no such field.
        ResultError: The field is det_f and the frame has none.
        MeshError: An array has the wrong shape, or the target is empty or not finite.
    """
    find(name)
    if name == "det_f":
        if det_f is None:
            raise ResultError(
                "This frame does not contain det F.",
                "Choose another field; det F is stored by flow, transport, joint and physics.",
            )
        return np.asarray(det_f, np.float32)
    points, finite = finite_points(positions)
    frame = _Frame(
        points=points,
        finite=finite,
        previous=np.asarray(source if previous is None else previous, np.float64),
        source=np.asarray(source, np.float64),
        target=target_points(target),
        known_spacing=spacing,
        workers=workers,
    )
    values = np.full(len(finite), np.nan, np.float32)
    if len(points):
        values[finite] = getattr(frame, name)()
    return values


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame's finite particles and what they are compared with; a method per field."""

    points: Points
    finite: npt.NDArray[np.bool_]
    previous: Points
    source: Points
    target: Points
    known_spacing: float | None
    workers: int

    @cached_property
    def target_tree(self) -> scipy.spatial.cKDTree:
        return scipy.spatial.cKDTree(self.target)

    @property
    def spacing(self) -> float:
        """Lattice spacing of the target [dx]."""
        if self.known_spacing is not None:
            return self.known_spacing
        gaps, _ = self.target_tree.query(self.target, k=[2], workers=self.workers)
        return float(np.median(gaps))

    def displacement(self) -> Points:
        return _lengths(self.points - self.source[self.finite])

    def speed(self) -> Points:
        return _lengths(self.points - self.previous[self.finite])

    def target_distance(self) -> Points:
        distance: Points = self.target_tree.query(self.points, workers=self.workers)[0]
        return distance

    def density(self) -> Points:
        """Particles over target points within a ball, over N / M, as rho of the metrics.

        Where the target is absent there is nothing to compare with, and half of a full ball is
        expected, which is what a particle at a free surface sees; one at a corner then counts as
        thin.
        """
        here, wanted = (
            cloud.query_ball_point(
                self.points, DENSITY_RADIUS, return_length=True, workers=self.workers
            )
            for cloud in (scipy.spatial.cKDTree(self.points), self.target_tree)
        )
        full = 4 / 3 * np.pi * DENSITY_RADIUS**3 / self.spacing**3
        even = np.maximum(wanted, full / 2) * (len(self.points) / len(self.target))
        ratio: Points = here / even
        return ratio

    def target_hits(self) -> npt.NDArray[np.intp]:
        _, nearest = self.target_tree.query(self.points, workers=self.workers)
        hits: npt.NDArray[np.intp] = np.bincount(nearest)[nearest]
        return hits

    def overlap(self) -> Points:
        distinct, which, copies = np.unique(
            self.points, axis=0, return_inverse=True, return_counts=True
        )
        tree = scipy.spatial.cKDTree(distinct)
        gap = distance_to_other(distinct, copies, tree, workers=self.workers)
        return gap[which.reshape(-1)] / self.spacing


def _lengths(vectors: Points) -> Points:
    lengths: Points = np.sqrt(np.einsum("pi,pi->p", vectors, vectors))
    return lengths
