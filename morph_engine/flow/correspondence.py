"""Like parts of two shapes: a coarse matching by fused Gromov-Wasserstein transport.

Each shape is stood for by control points, farthest-point samples weighted by the matter nearest to
them, and by the geodesic distances between these inside the shape. The transport plan T minimises::

    (1 - alpha) sum |x_i - y_j|^2 T_ij + alpha sum (D_ik - D'_jl)^2 T_ij T_kl

with lengths over the mean geodesic distance of each shape (Vayer et al. 2020). The problem has many
local minima, so it is solved from several starts: the plans that turn the source by each rotation
of a cube before they carry it to the target. Those that mirror the shape are left out.

Landmarks are the first controls of both shapes and belong together. The geodesic distances to them
take the place of x_i and y_j then, and give one start more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morph_engine import pot
from morph_engine.geometry.point_cloud import farthest_points

Points = NDArray[np.float64]

CONTROLS = 128
ALPHA = 0.9
"""Weight of the geodesic distances between controls."""

LANDMARK_ALPHA = 0.5
"""The same beside landmarks."""

ITERATIONS = 60

NODE_EDGE = 2.0
"""Edge of the cells whose points are represented by one node of the geodesic graph [h]."""

MOST_POINTS = 100_000
"""The graph of a shape with more points than this is as coarse as that of one with so many."""

GRAPH_REACH = 4.2
"""Nodes closer than this are neighbours [h]."""

NEIGHBORS = 12


@dataclass(frozen=True, eq=False)
class Controls:
    """Points that stand for a shape.

    Attributes:
        points: Positions [dx], shape [k, 3].
        weights: Share of the matter, shape [k], of sum 1.
        geodesic: Distances inside the shape, over their mean, shape [k, k].
        scale: That mean [dx].
        landmark_count: How many of them, the first, are landmarks.
    """

    points: Points
    weights: NDArray[np.float64]
    geodesic: NDArray[np.float64]
    scale: float
    landmark_count: int = 0


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Which parts of two shapes belong together.

    Attributes:
        source: Controls of the source.
        target: Controls of the target.
        plan: Transport plan between them, shape [k, l].
        distortion: Root mean square difference of matched geodesic distances, over their mean.
        plain_distortion: The same for the plan that is shortest in space.
    """

    source: Controls
    target: Controls
    plan: NDArray[np.float64]
    distortion: float
    plain_distortion: float

    @property
    def images(self) -> Points:
        """Where each control of the source belongs [dx], shape [k, 3]."""
        return images_of(self.plan, self.target)


def images_of(plan: NDArray[np.float64], target: Controls) -> Points:
    """Where a plan carries each control of the source [dx], shape [k, 3]; landmarks to landmarks.

    Args:
        plan: Shape [k, l].
        target: Controls of the target.
    """
    images: Points = (plan / np.maximum(plan.sum(axis=1, keepdims=True), 1e-300)) @ target.points
    images[: target.landmark_count] = target.points[: target.landmark_count]
    return images


def sample_controls(
    points: Points, spacing: float, landmarks: Points | None = None, count: int = CONTROLS
) -> Controls:
    """Control points of a shape.

    Args:
        points: Points that fill the shape [dx], shape [n, 3].
        spacing: Distance between them [dx].
        landmarks: Points that are to be controls [dx], shape [k, 3]; those nearest to them inside
            the shape have their geodesic distances.
        count: Controls beside the landmarks.
    """
    coarser = max(1.0, len(points) / MOST_POINTS) ** (1 / 3)
    nodes = _one_per_cell(points, NODE_EDGE * coarser * spacing)
    pairs = cKDTree(nodes).query_pairs(GRAPH_REACH * coarser * spacing, output_type="ndarray")
    lengths = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    graph = scipy.sparse.csr_array((lengths, pairs.T), shape=(len(nodes), len(nodes)))
    chosen = farthest_points(nodes, count)
    marked = np.empty((0, 3)) if landmarks is None else landmarks
    nearest_node = cKDTree(nodes).query(marked)[1]
    chosen = np.concatenate([nearest_node, chosen[~np.isin(chosen, nearest_node)]])
    geodesic = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=chosen)[:, chosen]
    finite = np.isfinite(geodesic)
    geodesic[~finite] = 2 * geodesic[finite].max()  # of parts that do not touch
    nearest = cKDTree(nodes[chosen]).query(points)[1]
    weights = np.bincount(nearest, minlength=len(chosen)) / len(points)
    scale = float(weights @ geodesic @ weights)
    controls = np.concatenate([marked, nodes[chosen[len(marked) :]]])
    return Controls(controls, weights, geodesic / scale, scale, len(marked))


def match(source: Controls, target: Controls) -> Correspondence:
    """Match the parts of two shapes."""
    a = (source.points - source.weights @ source.points) / source.scale
    b = (target.points - target.weights @ target.points) / target.scale
    cost = scipy.spatial.distance.cdist(a, b, "sqeuclidean")
    starts = [
        pot.load().emd(
            source.weights, target.weights, scipy.spatial.distance.cdist(turned, b, "sqeuclidean")
        )
        for turned in (rotation.apply(a) for rotation in Rotation.create_group("O"))
    ]
    plain = starts[0]
    alpha = ALPHA
    if source.landmark_count:
        alpha = LANDMARK_ALPHA
        to_landmarks = (each.geodesic[:, : each.landmark_count] for each in (source, target))
        cost = scipy.spatial.distance.cdist(*to_landmarks, "sqeuclidean") / source.landmark_count
        starts.append(pot.load().emd(source.weights, target.weights, cost))
    found: list[tuple[float, int, NDArray[np.float64]]] = []
    for start in starts:
        plan, log = pot.load().gromov.fused_gromov_wasserstein(
            cost, source.geodesic, target.geodesic, source.weights, target.weights,
            alpha=alpha, G0=start, log=True, max_iter=ITERATIONS,
        )  # fmt: skip
        if not _mirrors(source, target, plan):
            found.append((float(log["fgw_dist"]), len(found), plan))
    plan = min(found)[2] if found else plain
    return Correspondence(
        source, target, plan, _distortion(source, target, plan), _distortion(source, target, plain)
    )


def _distortion(source: Controls, target: Controls, plan: NDArray[np.float64]) -> float:
    here, there = source.geodesic, target.geodesic
    squares = source.weights @ here**2 @ source.weights + target.weights @ there**2 @ target.weights
    return math.sqrt(max(float(squares - 2 * np.sum((here @ plan @ there) * plan)), 0.0))


def _mirrors(source: Controls, target: Controls, plan: NDArray[np.float64]) -> bool:
    """Whether most of the matter would be turned inside out."""
    images = images_of(plan, target)
    near = np.argsort(source.geodesic, axis=1)[:, : NEIGHBORS + 1]
    here = source.points[near] - source.points[near].mean(axis=1, keepdims=True)
    there = images[near] - images[near].mean(axis=1, keepdims=True)
    kept = np.linalg.det(np.einsum("nki,nkj->nij", there, here)) > 0
    return bool(source.weights[kept].sum() < 0.5)


def _one_per_cell(points: Points, edge: float) -> Points:
    """Of the points of each cubic cell the one nearest to their mean."""
    _, cell = np.unique(np.floor(points / edge).astype(int), axis=0, return_inverse=True)
    cell = cell.ravel()
    counts = np.bincount(cell)
    means = np.stack([np.bincount(cell, column) for column in points.T], axis=1) / counts[:, None]
    order = np.lexsort((np.sum((points - means[cell]) ** 2, axis=1), cell))
    return points[order[np.cumsum(counts) - counts]]
