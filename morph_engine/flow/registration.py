"""Where each part of a shape belongs in another: an elastic registration of canonical forms.

The controls of the source are moved in its canonical form until they fill that of the target. In
turns each is drawn to where an entropic transport plan carries it, and all of them are fitted as
an elastic cloud, while the plan gets sharper (Feydy et al. 2019 for what draws them)::

    q <- fit(q + T(q, y) y - T(q, q) q),   T of the entropy 2 sigma^2

Forms are compared without their bends, so that a body bends to another where it can, and is torn
only where it must. There are many local minima, so coarser clouds are moved first, from several
starts: the affine motions between the moments of both forms after each rotation of a cube. The
best has the least strain, bending and motion. At last the images are carried from the target's form
to the target as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from morph_engine.flow.controls import Controls, best_rotation
from morph_engine.flow.elastic_cloud import ElasticCloud

Points = NDArray[np.float64]
Plan = NDArray[np.float32]

COARSE = 128
"""Controls that are moved from each start."""

STARTING = (2.0, 0.7)
"""sigma at the beginning and the end of a start [distances between controls]."""

REFINING = (1.5, 0.5)
"""The same where all controls are moved."""

STARTING_ROUNDS = 8
REFINING_ROUNDS = 12

ADHERENCE = (0.1, 2.0)
"""Of the fits, at the beginning and the end of a start."""

LANDMARK_ADHERENCE = 1e3

CARRIED_ADHERENCE = 20.0
"""Of the last fit, where the images are carried to the target as it is."""

BENDING_WEIGHT = 5.0
"""Of the bending beside the strain, where starts are compared."""

MOTION_WEIGHT = 2.0
"""Of the motion beside the strain."""

LANDMARK_WEIGHT = 5.0
"""Of what landmarks are apart at the start."""

FOLLOWED = 8
"""Controls that tell how a place of a form is carried."""

LEAST_STRETCH = 0.05

FLATNESS = 1e-9
"""Least second moment of a cloud in any direction, over that in all."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the controls of a source belong.

    Attributes:
        images: Their places in the target [dx], shape [k, 3].
        mismatch: Root mean square distance between images and controls of the target, both ways,
            over the distance between controls: some 0.6 where the images fill the target evenly.
        strain: Mean square of the logarithms of the stretches over their mean stretch.
    """

    images: Points
    mismatch: float
    strain: float


class _Cloud:
    """Controls of the source as they move through the target's form."""

    def __init__(self, source: Controls, target: Controls, growth: float) -> None:
        self.source = source
        self.target = target
        self.growth = growth
        self.elastic = ElasticCloud(source.form, source.form, growth)
        self.spacing = source.spacing

    def turns(self) -> list[Rotation]:
        """Rotations of a cube, and with landmarks that which brings these nearest."""
        turns = list(Rotation.create_group("O"))
        count = self.source.landmark_count
        if count:
            here, there = (
                end.form[:count] - end.weights @ end.form for end in (self.source, self.target)
            )
            turns.append(best_rotation(there, here))
        return turns

    def start(self, turn: Rotation) -> Points:
        """The turned source, made to have the moments of the target."""
        source, target = self.source, self.target
        turned = turn.apply(source.form - source.weights @ source.form)
        root, other = (
            scipy.linalg.sqrtm(_moments(points, weights)).real
            for points, weights in ((turned, source.weights), (target.form, target.weights))
        )
        inverse = np.linalg.inv(root)
        middle = scipy.linalg.sqrtm(root @ other @ other @ root).real
        stretch = inverse @ middle @ inverse
        placed: Points = turned @ stretch + target.weights @ target.form
        return placed

    def move(self, positions: Points, widths: tuple[float, float], rounds: int) -> Points:
        """Let the source fill the target, with plans that get sharper."""
        source, target = self.source, self.target
        to_target, to_itself = None, None
        marks = source.landmark_count
        for part in np.linspace(0, 1, rounds):
            width = self.spacing * widths[0] * (widths[1] / widths[0]) ** part
            adherence = ADHERENCE[0] * (ADHERENCE[1] / ADHERENCE[0]) ** part
            plan, to_target = transport(positions, target.form, source, target, width, to_target)
            own, to_itself = transport(positions, positions, source, source, width, to_itself)
            goals = positions + plan @ target.form - own @ positions
            goals[:marks] = target.form[:marks]
            positions = self.elastic.fit(goals, self.adherence(adherence), positions)
        return positions

    def adherence(self, value: float) -> NDArray[np.float64]:
        """Of each control: landmarks are met."""
        weights = value * len(self.source.weights) * self.source.weights
        weights[: self.source.landmark_count] = LANDMARK_ADHERENCE
        return weights

    def strain(self, positions: Points) -> float:
        """Mean square of the logarithms of the stretches."""
        stretches = np.linalg.svd(self.elastic.affine(positions), compute_uv=False) / self.growth
        logarithms = np.log(np.maximum(stretches, LEAST_STRETCH))
        return float(self.source.weights @ np.square(logarithms).sum(axis=1))

    def cost(self, start: Points, positions: Points) -> float:
        """What a start is judged by, and where it has led.

        Where there are landmarks, their distances at the start take the place of the motion of all
        controls.
        """
        source, target = self.source, self.target
        bending = source.weights @ self.elastic.bending(positions) / self.spacing**2
        here = source.points - source.weights @ source.points
        size = source.weights @ np.square(here).sum(axis=1)
        bent = self.strain(positions) + BENDING_WEIGHT * float(bending)
        marks = source.landmark_count
        if marks:
            apart = np.square(start[:marks] - target.form[:marks]).sum(axis=1).mean()
            return bent + LANDMARK_WEIGHT * float(apart / size)
        width = STARTING[1] * self.spacing
        plan, _ = transport(positions, target.form, source, target, width)
        there = plan @ target.points - target.weights @ target.points
        motion = source.weights @ np.square(there - here).sum(axis=1)
        return bent + MOTION_WEIGHT * float(motion / size)


def register(source: Controls, target: Controls, growth: float) -> Registration:
    """Find where the parts of a source belong.

    Args:
        source: Its controls.
        target: Those of the target, as many landmarks first.
        growth: Ratio of lengths of the target and the source where their volumes are equal parts.
    """
    coarse = _Cloud(source.thinned(COARSE), target.thinned(COARSE), growth)
    starts = [coarse.start(turn) for turn in coarse.turns()]
    found = [coarse.move(start, STARTING, STARTING_ROUNDS) for start in starts]
    costs = [coarse.cost(*places) for places in zip(starts, found, strict=True)]
    best = found[int(np.argmin(costs))]
    fine = _Cloud(source, target, growth)
    placed = carried(source.form, coarse.source.form, best, coarse.elastic)
    placed = fine.move(placed, REFINING, REFINING_ROUNDS)
    straight = ElasticCloud(target.form, target.form, 1.0)
    images = carried(placed, target.form, target.points, straight)
    images[: source.landmark_count] = target.points[: target.landmark_count]
    bent = ElasticCloud(source.points, source.form, growth)
    images = bent.fit(images, fine.adherence(CARRIED_ADHERENCE), images)
    return Registration(images, _mismatch(placed, target.form, fine.spacing), fine.strain(placed))


def carried(points: Points, start: Points, end: Points, cloud: ElasticCloud) -> Points:
    """Points that go along with the controls of a cloud near them [dx], shape [n, 3].

    Args:
        points: Where they are [dx], shape [n, 3].
        start: Where the controls are at rest [dx], shape [k, 3].
        end: Where they go [dx], shape [k, 3].
        cloud: Of these controls at rest.
    """
    distance, near = cKDTree(start).query(points, min(FOLLOWED, len(start)))
    weight = np.exp(-3 * (distance / distance[:, -1:]) ** 2)
    weight /= weight.sum(axis=1, keepdims=True)
    offset = points[:, None] - start[near]
    moved = np.matmul(cloud.affine(end)[near], offset[..., None])[..., 0] + end[near]
    found: Points = np.einsum("nk,nki->ni", weight, moved)
    return found


def transport(
    here: Points,
    there: Points,
    source: Controls,
    target: Controls,
    width: float,
    potential: Plan | None = None,
    rounds: int = 12,
) -> tuple[Plan, Plan]:
    """Entropic transport of squared distances (Sinkhorn), and a potential to start the next with.

    Args:
        here: Places of the source's controls [dx], shape [k, 3].
        there: Places of the target's [dx], shape [l, 3].
        source: Whose weights are carried.
        target: Whose weights are filled.
        width: sigma, where the entropy has the weight 2 sigma^2 [dx].
        potential: Of an earlier plan [dx^2], shape [k].
        rounds: Of the iteration.

    Returns:
        The plan over the weight of each control, rows of sum 1, shape [k, l]; its potential.
    """
    scale = 2 * width**2
    cost = (cdist(here, there, "sqeuclidean") / scale).astype(np.float32)
    first, second = (np.log(end.weights + 1e-12).astype(np.float32) for end in (source, target))
    f = np.zeros(len(here), np.float32) if potential is None else potential / np.float32(scale)
    for _ in range(rounds):
        g = -_log_sum(f[:, None] + first[:, None] - cost, axis=0)
        f = -_log_sum(g + second - cost, axis=1)
    plan = np.exp(f[:, None] + g + second - cost)
    return plan / plan.sum(axis=1, keepdims=True), f * np.float32(scale)


def _moments(points: Points, weights: NDArray[np.float64]) -> Points:
    """Second moments of a cloud, of some size in every direction even where it is flat."""
    moments = np.cov(points.T, aweights=weights)
    sized: Points = moments + FLATNESS * np.trace(moments) * np.eye(3)
    return sized


def _log_sum(exponents: Plan, axis: int) -> Plan:
    highest = exponents.max(axis=axis, keepdims=True)
    total = np.log(np.exp(exponents - highest).sum(axis=axis))
    summed: Plan = total + highest.squeeze(axis)
    return summed


def _mismatch(images: Points, target: Points, spacing: float) -> float:
    distances = (
        cKDTree(images).query(target)[0],
        cKDTree(target).query(images)[0],
    )
    return max(float(np.sqrt(np.square(each).mean())) for each in distances) / spacing
