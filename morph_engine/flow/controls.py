"""Control points that stand for a shape, and its form without bends.

The canonical form of a shape (Elad and Kimmel 2003) places its controls so that straight distances
between them are as nearly as possible the geodesic ones, inside the shape::

    min over x of sum_ij w_ij (|x_i - x_j| - d_ij)^2,   w_ij ~ 1 / d_ij

solved by majorisation (SMACOF, de Leeuw 1977) from the shape as it is. A bent body has there the
form of a straight one, and what lies side by side across a notch is apart.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from morph_engine.geometry.point_cloud import farthest_points, median_gap

Points = NDArray[np.float64]

CONTROLS = 800

ANCHORS = 250
"""Controls from which geodesic distances are taken, to all others."""

NODE_EDGE = 2.4
"""Edge of the cells whose points are represented by one node of the geodesic graph [h]."""

MOST_POINTS = 100_000
"""The graph of a shape with more points than this is as coarse as that of one with so many."""

GRAPH_REACH = 4.2
"""Nodes closer than this are neighbours [h]."""

RELAXATIONS = 6
"""Rounds in which controls move to the middle of the matter that is nearest to them."""

ROUNDS = 60
"""Of majorisation."""


@dataclass(frozen=True, eq=False)
class Controls:
    """Points that stand for a shape.

    Attributes:
        points: Positions [dx], shape [k, 3]; landmarks first.
        form: The same in the canonical form [dx], shape [k, 3].
        weights: Share of the matter, shape [k], of sum 1.
        landmark_count: How many of them are landmarks.
    """

    points: Points
    form: Points
    weights: NDArray[np.float64]
    landmark_count: int = 0

    @property
    def spacing(self) -> float:
        """Median distance to the nearest other control in the canonical form [dx]."""
        return median_gap(self.form, 1)

    def thinned(self, count: int) -> Controls:
        """So many of these controls, landmarks among them, with all of the matter."""
        far = farthest_points(self.form, count)
        marks = np.arange(self.landmark_count)
        chosen = np.concatenate([marks, far[far >= self.landmark_count]])
        nearest = cKDTree(self.form[chosen]).query(self.form)[1]
        weights = np.bincount(nearest, self.weights, len(chosen)).astype(np.float64)
        return Controls(self.points[chosen], self.form[chosen], weights, len(marks))


def sample_controls(
    points: Points, spacing: float, landmarks: Points | None = None, count: int = CONTROLS
) -> Controls:
    """Control points of a shape.

    Args:
        points: Points that fill the shape [dx], shape [n, 3].
        spacing: Distance between them [dx].
        landmarks: Points that are to be controls [dx], shape [k, 3].
        count: Controls beside the landmarks.
    """
    coarser = max(1.0, len(points) / MOST_POINTS) ** (1 / 3)
    nodes, held = _one_per_cell(points, NODE_EDGE * coarser * spacing)
    pairs = cKDTree(nodes).query_pairs(GRAPH_REACH * coarser * spacing, output_type="ndarray")
    lengths = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    graph = scipy.sparse.csr_array((lengths, pairs.T), shape=(len(nodes), len(nodes)))

    marks = np.empty((0, 3)) if landmarks is None else landmarks
    controls = np.concatenate([marks, _spread(nodes, held, count)])
    weights = np.bincount(cKDTree(controls).query(nodes)[1], held, len(controls)) / held.sum()
    at = cKDTree(nodes).query(controls)[1]
    anchors = at[: len(marks) + ANCHORS]  # landmarks, then controls far from each other
    geodesic = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=anchors)[:, at]
    finite = np.isfinite(geodesic)
    geodesic[~finite] = 2 * geodesic[finite].max()  # of pieces that do not touch
    geodesic = np.maximum(geodesic, cdist(controls[: len(anchors)], controls))
    form = canonical_form(controls, geodesic, weights)
    return Controls(controls, form, weights, len(marks))


def canonical_form(points: Points, geodesic: Points, weights: NDArray[np.float64]) -> Points:
    """Points apart by their geodesic distances, turned and placed as the shape is [dx], [k, 3].

    Args:
        points: Points of the shape [dx], shape [k, 3].
        geodesic: Distances inside the shape from the first of them to all [dx], shape [m, k].
        weights: Share of the matter of each, shape [k], of sum 1.
    """
    first = len(geodesic)
    some = weights + 1e-3 / len(weights)
    stiffness = some[:first, None] * some / np.maximum(geodesic, 1e-9)
    stiffness[:, :first] /= 2  # these are there twice
    inverse = np.linalg.pinv(_laplacian(stiffness), hermitian=True)
    form = points
    for _ in range(ROUNDS):
        pull = stiffness * geodesic / np.maximum(cdist(form[:first], form), 1e-9)
        pulled = pull.sum(axis=0)[:, None] * form - pull.T @ form[:first]
        pulled[:first] += pull.sum(axis=1)[:, None] * form[:first] - pull @ form
        form = inverse @ pulled
    centre = weights @ points
    form = form - weights @ form
    placed: Points = best_rotation(points - centre, form, weights).apply(form) + centre
    return placed


def best_rotation(
    there: Points, here: Points, weights: NDArray[np.float64] | None = None
) -> Rotation:
    """The rotation about the origin that brings points nearest to others, each shape [k, 3]."""
    if not (there.any() and here.any()):
        return Rotation.identity()  # a single point
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # points on a line leave a turn free
        return Rotation.align_vectors(there, here, weights=weights)[0]


def _laplacian(weights: Points) -> Points:
    """Of a graph whose edges from the first of its nodes to all have weights, shape [m, k]."""
    first, count = weights.shape
    matrix = np.zeros((count, count))
    matrix[:first] -= weights
    matrix[:, :first] -= weights.T
    return matrix - np.diag(matrix.sum(axis=1))


def _spread(nodes: Points, held: NDArray[np.float64], count: int) -> Points:
    """Centres of so many parts of a shape, of about equal size (Lloyd's relaxation)."""
    centres = nodes[farthest_points(nodes, count)]
    for _ in range(RELAXATIONS):
        nearest = cKDTree(centres).query(nodes)[1]
        matter = np.bincount(nearest, held, len(centres))
        sums = [np.bincount(nearest, held * along, len(centres)) for along in nodes.T]
        centres = np.stack(sums, axis=1) / matter[:, None]
    return centres


def _one_per_cell(points: Points, edge: float) -> tuple[Points, NDArray[np.float64]]:
    """Of the points of each cubic cell the one nearest to their mean, and how many there are."""
    _, cell = np.unique(np.floor(points / edge).astype(int), axis=0, return_inverse=True)
    cell = cell.ravel()
    counts = np.bincount(cell)
    means = np.stack([np.bincount(cell, column) for column in points.T], axis=1) / counts[:, None]
    order = np.lexsort((np.sum((points - means[cell]) ** 2, axis=1), cell))
    return points[order[np.cumsum(counts) - counts]], counts.astype(np.float64)
