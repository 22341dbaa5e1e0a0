"""A motion that carries the source's parts to where they belong.

Around each control point x_i with its image q_i the motion is affine, A_i = R_i S_i. On the way the
rotation is part of the whole one (the shapes' common rotation and what remains of each,
interpolated as rotations) and the stretch a power of the whole one, S_i^s, so that volumes change
evenly. The positions are those that fit the edges carried so best (Alexa et al. 2000). Pieces that
no edge connects go straight from place to place, seen from axes that turn with the whole. In
between, points follow the controls near them.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morph_engine.blas_threads import one_blas_thread
from morph_engine.flow.controls import Controls, best_rotation
from morph_engine.flow.elastic_cloud import ElasticCloud
from morph_engine.flow.registration import Registration
from morph_engine.row_blocks import row_blocks

Points = NDArray[np.float64]
Edges = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]
Piece = slice | NDArray[np.intp]

FOLLOWED = 8
"""Controls that a point follows."""

SMOOTHINGS = 2
"""Rounds in which the affine motion of a control is averaged with those of its neighbours."""

LEAST_STRETCH = 0.15

SHARES_KEPT = 8
"""Shares of the change at which the controls are kept: those of the frames being made."""

LARGEST_SWEEP = 1.2
"""Where the mean of the controls goes straight, the farthest may be so many times as far from the
origin on the way as at its ends: a body off the origin that turns about itself would leave the
grid, which holds a ball about the origin. It turns about that, then."""

SWEEP_SHARES = (0.25, 0.5, 0.75)

LEAST_DISTANCE = 0.05
"""From a landmark, below which points follow it equally [distances between controls]."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Controls that points follow.

    Attributes:
        points: Where the points are [dx], shape [n, 3].
        controls: Where the controls are [dx], shape [k, 3].
        near: The controls that each point follows, shape [n, f].
        weights: How much it follows each of them, rows of sum 1, shape [n, f].
    """

    points: Points
    controls: Points
    near: NDArray[np.int32]
    weights: Points

    def carried(self, controls: Points, affine: Points) -> Points:
        """Where the points are when the controls are there, and moved so around them, [n, 3]."""
        shifts = controls - np.einsum("kij,kj->ki", affine, self.controls)
        motions = np.concatenate([affine, shifts[:, :, None]], axis=2).reshape(len(controls), -1)
        carried = np.empty_like(self.points)
        for block in row_blocks(len(carried)):
            own = (self._weights(block) @ motions).reshape(-1, 3, 4)
            turned = np.einsum("nij,nj->ni", own[:, :, :3], self.points[block])
            carried[block] = turned + own[:, :, 3]
        return carried

    def _weights(self, points: slice) -> scipy.sparse.csr_array:
        """How much some of the points follow each control, sparse, shape [m, k]."""
        near, weights = self.near[points], self.weights[points]
        rows = np.arange(len(near) + 1, dtype=np.int32) * near.shape[1]
        shape = len(near), len(self.controls)
        return scipy.sparse.csr_array((weights.ravel(), near.ravel(), rows), shape=shape)


class Warp:
    """The motion of control points, and of space with them.

    Args:
        source: Controls of the source.
        registration: Where they belong.

    Attributes:
        start: The controls in the source [dx], shape [k, 3].
        end: Their images [dx], shape [k, 3].
        at: Tells where the controls are after a share of the change [dx], shape [k, 3], and the
            affine motions there, shape [k, 3, 3]; the last shares asked for are kept.
    """

    def __init__(self, source: Controls, registration: Registration) -> None:
        self.start: Points = source.points
        self.end: Points = registration.images
        self._landmark_count = source.landmark_count
        self._spacing = float(np.median(cKDTree(self.start).query(self.start, 2)[0][:, 1]))
        cloud = ElasticCloud(source.points, source.form, 1.0)
        self._edges = _edges(self.start, cloud.near)
        self._pieces = _pieces(self._edges, len(self.start))
        self._grounded = scipy.linalg.cho_factor(self._laplacian())
        affine = cloud.affine(self.end)
        for _ in range(SMOOTHINGS):
            affine = (affine + affine[cloud.near].mean(axis=1)) / 2
        u, stretch, axes = np.linalg.svd(affine)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ axes))[:, None]
        self._logarithm = np.log(np.maximum(stretch, LEAST_STRETCH))
        self._axes = axes
        self._whole = best_rotation(
            self.end - self.end.mean(axis=0), self.start - self.start.mean(axis=0)
        )
        self._rest = self._whole.inv() * Rotation.from_matrix(u @ axes)
        self._turns_about_origin = self._sweeps_far()
        self._remainder = self.end - self._placed(self.affine(1.0), 1.0)
        self.at = functools.lru_cache(SHARES_KEPT)(self._controls_at)

    def _controls_at(self, share: float) -> tuple[Points, Points]:
        with one_blas_thread():
            affine = self.affine(share)
            return self._placed(affine, share) + share * self._remainder, affine

    def affine(self, share: float) -> Points:
        """The affine motion around each control after a share of the change, shape [k, 3, 3]."""
        stretch = np.exp(share * self._logarithm)[:, :, None] * self._axes
        affine: Points = self.rotations(share).as_matrix() @ self._axes.transpose(0, 2, 1) @ stretch
        return affine

    def rotations(self, share: float) -> Rotation:
        """Rotations of the controls after a share of the change."""
        whole = Rotation.from_rotvec(share * self._whole.as_rotvec())
        return whole * Rotation.from_rotvec(share * self._rest.as_rotvec())

    def follow(self, points: Points) -> Followed:
        """Which controls points of the source follow, shape [n, 3]."""
        return self._followed(points, self.start)

    def ends(self, points: Points, share: float) -> tuple[Points, Points]:
        """Where points at a share of the change come from, and belong, each shape [n, 3]."""
        now, affine = self.at(share)
        followed = self._followed(points, now)
        back = np.linalg.inv(affine).astype(np.float64)
        return (
            followed.carried(self.start, back),
            followed.carried(self.end, self.affine(1.0) @ back),
        )

    def forward(self, followed: Followed, share: float) -> Points:
        """Where points of the source are after a share of the change [dx], shape [n, 3]."""
        return followed.carried(*self.at(share))

    def _followed(self, points: Points, controls: Points) -> Followed:
        """The controls that each point follows; close to a landmark it alone, so that it is met."""
        distance, near = cKDTree(controls).query(points, min(FOLLOWED, len(controls)))
        reach = np.maximum(distance[:, -1:], 1.5 * self._spacing)
        weight = (1 - (distance / (1.001 * reach)) ** 2) ** 2
        if self._landmark_count:
            close = 1 + (self._spacing / np.maximum(distance, LEAST_DISTANCE * self._spacing)) ** 2
            weight = np.where(near < self._landmark_count, close * weight, weight)
        weight = weight / weight.sum(axis=1, keepdims=True)
        return Followed(points, controls, near.astype(np.int32), weight)

    def _laplacian(self) -> Points:
        """Of the edges, and regular: the mean of each piece is held."""
        i, j, weight = self._edges
        laplacian = np.zeros((len(self.start),) * 2)
        np.add.at(laplacian, (i, j), -weight)
        np.add.at(laplacian, (i, i), weight)
        for piece in self._pieces:
            block = (piece, piece) if isinstance(piece, slice) else np.ix_(piece, piece)
            laplacian[block] += 1 / len(self.start[piece])
        return laplacian

    def _placed(self, affine: Points, share: float) -> Points:
        """Positions that fit the carried edges best, with their mean where it is by then."""
        middle = self._turned_middle(share) if self._turns_about_origin else self._middle(share)
        placed: Points = self._shape(affine, share) + middle
        return placed

    def _shape(self, affine: Points, share: float) -> Points:
        """The same about their mean."""
        i, j, weight = self._edges
        edges = self.start[i] - self.start[j]
        carried = np.einsum("eij,ej->ei", (affine[i] + affine[j]) / 2, edges)
        right = np.zeros_like(self.start)
        np.add.at(right, i, weight[:, None] * carried)
        free = scipy.linalg.cho_solve(self._grounded, right)
        if len(self._pieces) > 1:
            for piece in self._pieces:
                free[piece] += self._offset(piece, share) - free[piece].mean(axis=0)
        shape: Points = free - free.mean(axis=0)
        return shape

    def _offset(self, piece: Piece, share: float) -> Points:
        """The mean of a piece from that of all: on a straight line, as the whole turns."""
        begin, end = (at[piece].mean(axis=0) - at.mean(axis=0) for at in (self.start, self.end))
        turn = Rotation.from_rotvec(share * self._whole.as_rotvec())
        offset: Points = turn.apply((1 - share) * begin + share * self._whole.inv().apply(end))
        return offset

    def _middle(self, share: float) -> Points:
        """The mean of the controls on a straight line."""
        middle: Points = (1 - share) * self.start.mean(axis=0) + share * self.end.mean(axis=0)
        return middle

    def _turned_middle(self, share: float) -> Points:
        """The mean of the controls turned about the origin as the shapes are."""
        begin, end = self.start.mean(axis=0), self.end.mean(axis=0)
        turn = Rotation.from_rotvec(share * self._whole.as_rotvec())
        middle: Points = turn.apply(begin) + share * (end - self._whole.apply(begin))
        return middle

    def _sweeps_far(self) -> bool:
        """Whether a straight mean takes controls much farther from the origin than its ends do."""
        on_the_way = (self._shape(self.affine(s), s) + self._middle(s) for s in SWEEP_SHARES)
        ends = _farthest(self.start), _farthest(self.end)
        return max(map(_farthest, on_the_way)) > LARGEST_SWEEP * max(ends)


def _pieces(edges: Edges, count: int) -> list[Piece]:
    """The controls of each part of the graph that no edge connects with another."""
    i, j, weight = edges
    graph = scipy.sparse.csr_array((weight, (i, j)), shape=(count, count))
    pieces, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
    if pieces == 1:
        return [slice(None)]
    return [np.flatnonzero(labels == piece) for piece in range(pieces)]


def _farthest(points: Points) -> float:
    return float(np.linalg.norm(points, axis=1).max())


def _edges(points: Points, near: NDArray[np.intp]) -> Edges:
    """Both directions of the edges between neighbours, and their weights."""
    first = np.repeat(np.arange(len(near)), near.shape[1])
    pairs = np.stack([first, near.ravel()], axis=1)
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    i, j = pairs.T
    weight = 1 / np.maximum(np.linalg.norm(points[i] - points[j], axis=1), 1e-3)
    return i, j, weight / weight.mean()
