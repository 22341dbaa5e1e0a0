"""Points that resist bending and turning inside out, but not stretching.

Around each point the motion x -> q is compared with the affine one A_i that fits its neighbours
best. The energy has two parts::

    sum_i 1/k sum_j |q_j - q_i - A_i (x_j - x_i)|^2          what is not affine: bends, cuts
    nu sum_i 1/k sum_j |q_j - q_i - B_i (x_j - x_i)|^2       what turns over, or is too thin

where B_i is A_i averaged with its neighbours', with stretches within bounds and the orientation
kept; where neighbours do not determine A_i, it is a rotation. The first part is quadratic in q,
since A_i is linear in it; the second is solved with B_i of the last q (local and global steps, as
in Sorkine and Alexa 2007).
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Points = NDArray[np.float64]

NEIGHBORS = 16

ORIENTATION = 0.1
"""nu: weight of the second part."""

RIGIDITY = 0.02
"""Weight of the rotation beside the neighbours, where an affine motion is fitted."""

STRETCHES = (0.2, 4.0)
"""Bounds of the stretches, over the mean stretch."""

SWEEPS = 2
"""Local and global steps of a fit."""


class ElasticCloud:
    """The points at rest, and their energy.

    Args:
        points: At rest [dx], shape [k, 3].
        form: Where distances tell which are neighbours [dx], shape [k, 3].
        growth: Mean stretch between this shape and the one it is to become.
    """

    def __init__(self, points: Points, form: Points, growth: float) -> None:
        count = len(points)
        reach = min(NEIGHBORS, count - 1)
        self.near: NDArray[np.intp] = cKDTree(form).query(form, reach + 1)[1][:, 1:]
        self._bounds = STRETCHES[0] * growth, STRETCHES[1] * growth
        self._edges = points[self.near] - points[:, None]
        self._growth = growth
        self._inverse = np.linalg.pinv(self._edges)
        moments = np.matmul(self._edges.transpose(0, 2, 1), self._edges)
        self._least = RIGIDITY * np.trace(moments, axis1=1, axis2=2) / 3
        self._moments = np.linalg.inv(moments + self._least[:, None, None] * np.eye(3))
        self._first = np.repeat(np.arange(count), reach)
        self._second = self.near.ravel()
        self._matrix = self._bending() + ORIENTATION * self._laplacian()

    def affine(self, positions: Points) -> Points:
        """The affine motion around each point that fits its neighbours, shape [k, 3, 3].

        In directions in which a point has hardly any neighbours, as across a thin limb, it is a
        rotation.
        """
        edges = positions[self.near] - positions[:, None]
        spread = np.matmul(edges.transpose(0, 2, 1), self._edges)
        u, _, vt = np.linalg.svd(spread)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        rigid = self._growth * (u @ vt)
        fitted: Points = (spread + self._least[:, None, None] * rigid) @ self._moments
        return fitted

    def bending(self, positions: Points) -> NDArray[np.float64]:
        """Mean square of what is not affine around each point [dx^2], shape [k]."""
        edges = positions[self.near] - positions[:, None]
        rest = edges - np.matmul(self._edges, np.matmul(self._inverse, edges))
        mean: NDArray[np.float64] = np.square(rest).sum(axis=2).mean(axis=1)
        return mean

    def fit(self, goals: Points, adherence: NDArray[np.float64], positions: Points) -> Points:
        """Positions of least energy that are drawn to goals [dx], shape [k, 3].

        Args:
            goals: Where each point is drawn to [dx], shape [k, 3].
            adherence: How much, shape [k].
            positions: Where the points are before [dx], shape [k, 3].
        """
        factor = scipy.linalg.cho_factor(self._matrix + np.diag(adherence))
        for _ in range(SWEEPS):
            right = adherence[:, None] * goals + ORIENTATION * self._divergence(positions)
            positions = scipy.linalg.cho_solve(factor, right)
        return positions

    def _divergence(self, positions: Points) -> Points:
        """What the second part pulls at each point, with its affine motions as they are now."""
        affine = self.affine(positions)
        u, stretch, vt = np.linalg.svd((affine + affine[self.near].mean(axis=1)) / 2)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        kept = (u * np.clip(stretch, *self._bounds)[:, None]) @ vt
        pulls = np.matmul(self._edges, kept.transpose(0, 2, 1)).reshape(-1, 3) / self.near.shape[1]
        total = np.zeros_like(positions)
        np.add.at(total, self._second, pulls)
        np.subtract.at(total, self._first, pulls)
        return total

    def _bending(self) -> Points:
        """Matrix of the first part: the projection of edges off all affine motions, summed up."""
        count, reach = self.near.shape
        off = np.eye(reach) - np.matmul(self._edges, self._inverse)
        of_centre = -off.sum(axis=2)
        block = np.empty((count, reach + 1, reach + 1))
        block[:, :reach, :reach] = off
        block[:, :reach, reach] = block[:, reach, :reach] = of_centre
        block[:, reach, reach] = -of_centre.sum(axis=1)
        index = np.concatenate([self.near, np.arange(count)[:, None]], axis=1)
        matrix = np.zeros((count, count))
        np.add.at(matrix, (index[:, :, None], index[:, None]), block / reach)
        return matrix

    def _laplacian(self) -> Points:
        count, reach = self.near.shape
        matrix = np.zeros((count, count))
        np.add.at(matrix, (self._first, self._second), -1 / reach)
        matrix += matrix.T
        return matrix - np.diag(matrix.sum(axis=1))
