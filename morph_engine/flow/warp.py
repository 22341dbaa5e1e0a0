"""A motion that carries the source's parts to where they belong, as rigidly as possible.

Control points x_i with images q_i have rotations R_i about them. On the way each rotation is part
of the whole one (the shapes' common rotation and what remains of each, interpolated as rotations),
and the positions are those that fit the turned edges best (Alexa et al. 2000, Sorkine and Alexa
2007). In between, points follow the controls near them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morph_engine import pot
from morph_engine.flow.correspondence import Controls, Correspondence, images_of

Points = NDArray[np.float64]

EDGES = 8
"""Neighbours of a control inside the shape."""

FOLLOWED = 8
"""Controls that a point follows."""

ROUNDS = 8
ADHERENCE = 0.1
"""Weight of the images against that of rigid edges."""

LANDMARK_ADHERENCE = 1e3
"""That of landmarks."""

LEAST_DISTANCE = 0.05
"""From a landmark, below which points follow it equally [distances between controls]."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Controls that points follow.

    Attributes:
        near: Their indices, shape [n, FOLLOWED].
        weight: How much each is followed, of sum 1, shape [n, FOLLOWED].
        offset: From each of them to the point [dx], shape [n, FOLLOWED, 3].
    """

    near: NDArray[np.intp]
    weight: Points
    offset: Points


class Warp:
    """The motion of control points, and of space with them.

    Args:
        correspondence: Which parts belong together.
    """

    def __init__(self, correspondence: Correspondence) -> None:
        source, target = correspondence.source, correspondence.target
        self.start: Points = source.points
        self.end: Points
        self._edges = _edges(source)
        self._landmark_count = source.landmark_count
        self._laplacian = self._assemble()
        self._grounded = scipy.linalg.cho_factor(self._laplacian + 1 / len(source.points))
        self._adherence = np.full(len(source.points), ADHERENCE)
        self._adherence[: self._landmark_count] = LANDMARK_ADHERENCE
        self.end, rotations = self._fit(correspondence.images)
        for _ in range(ROUNDS):
            self.end, rotations = self._fit(_spread(self.end, source, target))
        self._whole = Rotation.align_vectors(
            self.end - self.end.mean(axis=0), self.start - self.start.mean(axis=0)
        )[0]
        self._rest = self._whole.inv() * rotations
        self._spacing = float(np.median(cKDTree(self.start).query(self.start, 2)[0][:, 1]))
        self._remainder = self.end - self._place(1.0, np.zeros_like(self.end))

    def at(self, share: float) -> tuple[Points, Rotation]:
        """Controls after a share of the way [dx], shape [k, 3], and their rotations."""
        return self._place(share, share * self._remainder), self.rotations(share)

    def rotations(self, share: float) -> Rotation:
        """Rotations of the controls after a share of the way."""
        whole = Rotation.from_rotvec(share * self._whole.as_rotvec())
        return whole * Rotation.from_rotvec(share * self._rest.as_rotvec())

    def follow(self, points: Points) -> Followed:
        """Which controls points of the source follow, shape [n, 3]."""
        near, weight = self._followed(points, self.start)
        return Followed(near, weight, points[:, None] - self.start[near])

    def ends(self, points: Points, share: float) -> tuple[Points, Points]:
        """Where points at a share of the way come from and where they belong, each shape [n, 3]."""
        now, turned = self.at(share)
        near, weight = self._followed(points, now)
        followed = Followed(near, weight, points[:, None] - now[near])
        inverse = turned.inv()
        return (
            _carried(followed, self.start, inverse),
            _carried(followed, self.end, self.rotations(1.0) * inverse),
        )

    def forward(self, followed: Followed, share: float) -> Points:
        """Where points of the source are after a share of the way [dx], shape [n, 3]."""
        return _carried(followed, *self.at(share))

    def _followed(self, points: Points, controls: Points) -> tuple[NDArray[np.intp], Points]:
        """The controls that each point follows, and how much, both shape [n, FOLLOWED].

        Close to a landmark points follow it alone, so that it is met.
        """
        distance, near = cKDTree(controls).query(points, FOLLOWED)
        reach = np.maximum(distance[:, -1:], 1.5 * self._spacing)
        weight = (1 - (distance / (1.001 * reach)) ** 2) ** 2
        close = 1 + (self._spacing / np.maximum(distance, LEAST_DISTANCE * self._spacing)) ** 2
        weight = np.where(near < self._landmark_count, close * weight, weight)
        return near, weight / weight.sum(axis=1, keepdims=True)

    def _assemble(self) -> NDArray[np.float64]:
        i, j, weight = self._edges
        n = len(self.start)
        laplacian = np.zeros((n, n))
        np.add.at(laplacian, (i, j), -weight)
        np.add.at(laplacian, (i, i), weight)
        return laplacian

    def _divergence(self, matrices: Points) -> Points:
        """Right-hand side of the positions that fit the turned edges."""
        i, j, weight = self._edges
        turned = np.einsum(
            "eij,ej->ei", (matrices[i] + matrices[j]) / 2, self.start[i] - self.start[j]
        )
        total = np.zeros_like(self.start)
        np.add.at(total, i, weight[:, None] * turned)
        return total

    def _fit(self, images: Points) -> tuple[Points, Rotation]:
        """Positions near the images that keep edges rigid, and the rotations about them."""
        factor = scipy.linalg.cho_factor(self._laplacian + np.diag(self._adherence))
        positions = images
        for _ in range(ROUNDS):
            rotations = self._turned(positions)
            right = self._divergence(rotations.as_matrix()) + self._adherence[:, None] * images
            positions = scipy.linalg.cho_solve(factor, right)
        return positions, self._turned(positions)

    def _turned(self, positions: Points) -> Rotation:
        """The rotation about each control that fits its edges best."""
        i, j, weight = self._edges
        spread = np.zeros((len(positions), 3, 3))
        outer = (positions[i] - positions[j])[:, :, None] * (self.start[i] - self.start[j])[:, None]
        np.add.at(spread, i, weight[:, None, None] * outer)
        u, _, vt = np.linalg.svd(spread)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        return Rotation.from_matrix(u @ vt)

    def _place(self, share: float, remainder: Points) -> Points:
        right = self._divergence(self.rotations(share).as_matrix())
        free = scipy.linalg.cho_solve(self._grounded, right)
        middle = (1 - share) * self.start.mean(axis=0) + share * self.end.mean(axis=0)
        placed: Points = free - free.mean(axis=0) + middle + remainder
        return placed


def _carried(followed: Followed, controls: Points, turned: Rotation) -> Points:
    """Points that follow controls which have moved and turned."""
    near, offset = followed.near, followed.offset
    matrices = turned.as_matrix()[near]
    moved = np.matmul(matrices, offset[..., None])[..., 0] + controls[near]
    carried: Points = np.einsum("nk,nki->ni", followed.weight, moved)
    return carried


def _edges(controls: Controls) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Both directions of the edges between controls near each other inside the shape."""
    near = np.argsort(controls.geodesic, axis=1)[:, 1 : EDGES + 1]
    first = np.repeat(np.arange(len(near)), EDGES)
    pairs = np.stack([first, near.ravel()], axis=1)
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    weight = 1 / np.maximum(controls.geodesic[pairs[:, 0], pairs[:, 1]], 1e-3)
    return pairs[:, 0], pairs[:, 1], weight / weight.mean()


def _spread(positions: Points, source: Controls, target: Controls) -> Points:
    """Where positions that are nearly right belong: the nearest transport to the target."""
    cost = scipy.spatial.distance.cdist(positions, target.points, "sqeuclidean")
    plan = pot.load().emd(source.weights, target.weights, cost)
    return images_of(plan, target)
