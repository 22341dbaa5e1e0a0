"""The step in NumPy, float64, tuned: a loop over the 64 stencil nodes keeps arrays in the cache."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.scene import (
    DRAG,
    DT,
    GRID_MIN,
    LAMBDA,
    MASS_FLOOR,
    MU,
    NODES_PER_AXIS,
    SMOOTHING,
    Layer,
    Scene,
)

Array = NDArray[np.float64]
INERTIA = 3.0  # c of the cubic B-spline


class NumpyStep:
    """A `Stepper`; the scatter is one bincount per node and component."""

    name: ClassVar[str] = "NumPy float64, tuned"

    def __init__(self, scene: Scene) -> None:
        layer = scene.layer
        self.x, self.v, self.C, self.F, self.U, self.volume = (
            np.ascontiguousarray(a, dtype=np.float64)
            for a in (layer.x, layer.v, layer.C, layer.F, scene.U, scene.volume)
        )
        self.mass = scene.mass
        self.next: Layer | None = None

    def advance(self) -> None:
        """One step: particles to grid, grid velocity, grid to particles."""
        A = self.F + self.U
        stress = (-INERTIA * DT) * self.volume[:, None, None] * kirchhoff(A)
        affine = stress + self.mass * self.C
        stencil = Stencil(self.x)
        mass, momentum = self.scatter(stencil, affine)
        velocity = np.divide(momentum, mass, out=np.zeros_like(momentum), where=mass > MASS_FLOOR)
        v, C = gather(stencil, velocity)
        self.next = Layer(
            x=self.x + DT * v,
            v=v,
            C=C,
            F=(1 - SMOOTHING) * (A + DT * (C @ A)) + SMOOTHING * self.F,
        )

    def scatter(self, stencil: Stencil, affine: Array) -> tuple[Array, Array]:
        """Grid mass [nodes] and momentum [3, nodes]."""
        nodes = NODES_PER_AXIS**3
        mass, momentum = np.zeros(nodes), np.zeros((3, nodes))
        translational = ((1 - DT * DRAG) * self.mass * self.v).T
        columns = np.ascontiguousarray(affine.transpose(1, 2, 0))
        for node, weight, d in stencil:
            mass += np.bincount(node, weight, nodes)
            for a in range(3):
                row = columns[a]
                value = translational[a] + row[0] * d[0] + row[1] * d[1] + row[2] * d[2]
                momentum[a] += np.bincount(node, weight * value, nodes)
        return self.mass * mass, momentum

    def result(self) -> Layer:
        """Return the layer after the scene's."""
        if self.next is None:
            raise RuntimeError("advance() comes first")
        return self.next


class Stencil:
    """The 64 nodes around every particle; iterates over (node, weight, node minus particle)."""

    def __init__(self, x: Array) -> None:
        u = x.T - GRID_MIN
        base = np.clip(np.floor(u).astype(np.intp) - 1, 0, NODES_PER_AXIS - 4)
        self.corner = (base[0] * NODES_PER_AXIS + base[1]) * NODES_PER_AXIS + base[2]
        self.distance = np.stack([base + i - u for i in range(4)])
        r = np.abs(self.distance)
        self.weight = (np.maximum(2 - r, 0) ** 3 - 4 * np.maximum(1 - r, 0) ** 3) / 6

    def __iter__(self) -> Iterator[tuple[NDArray[np.intp], Array, tuple[Array, Array, Array]]]:
        w, d = self.weight, self.distance
        for i, j in product(range(4), repeat=2):
            plane = w[i, 0] * w[j, 1]
            for k in range(4):
                node = self.corner + ((i * NODES_PER_AXIS + j) * NODES_PER_AXIS + k)
                yield node, plane * w[k, 2], (d[i, 0], d[j, 1], d[k, 2])


def gather(stencil: Stencil, velocity: Array) -> tuple[Array, Array]:
    """Particle velocity [n, 3] and affine velocity [n, 3, 3] from node velocity [3, nodes]."""
    count = len(stencil.corner)
    v, C = np.zeros((3, count)), np.zeros((3, 3, count))
    for node, weight, d in stencil:
        for a in range(3):
            share = weight * velocity[a, node]
            v[a] += share
            for b in range(3):
                C[a, b] += share * d[b]
    return np.ascontiguousarray(v.T), np.ascontiguousarray(INERTIA * C.transpose(2, 0, 1))


def kirchhoff(A: Array) -> Array:
    """Neo-Hookean P A^T = mu (A A^T - I) + lambda ln(det A) I."""
    pressure = LAMBDA * np.log(np.linalg.det(A)) - MU
    return MU * (A @ A.transpose(0, 2, 1)) + pressure[:, None, None] * np.eye(3)
