"""The step in NumPy, float64, as it is usually written: whole [n, 64] arrays, einsum, bincount."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

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

INERTIA = 3.0  # c of the cubic B-spline
OFFSETS = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(64, 3)


class NumpyWholeArray:
    """A `Stepper`: every formula of the algorithm is one whole-array expression."""

    name: ClassVar[str] = "NumPy float64"

    def __init__(self, scene: Scene) -> None:
        layer = scene.layer
        self.x, self.v, self.C, self.F, self.U, self.volume = (
            np.asarray(a, dtype=np.float64)
            for a in (layer.x, layer.v, layer.C, layer.F, scene.U, scene.volume)
        )
        self.mass = scene.mass
        self.next: Layer | None = None

    def advance(self) -> None:
        """One step: particles to grid, grid velocity, grid to particles."""
        identity = np.eye(3)
        A = self.F + self.U
        inverse_transpose = np.linalg.inv(A).transpose(0, 2, 1)
        log_volume = np.log(np.linalg.det(A))[:, None, None]
        P = MU * (A - inverse_transpose) + LAMBDA * log_volume * inverse_transpose
        tau = self.volume[:, None, None] * P @ A.transpose(0, 2, 1)
        B = self.mass * self.C - INERTIA * DT * tau

        base = np.clip(np.floor(self.x - GRID_MIN).astype(int) - 1, 0, NODES_PER_AXIS - 4)
        near = cubic(base[:, :, None] + np.arange(4) + GRID_MIN - self.x[:, :, None])
        weight = np.einsum("pi,pj,pk->pijk", *near.transpose(1, 0, 2)).reshape(-1, 64)
        node = base[:, None, :] + OFFSETS
        index = node @ (NODES_PER_AXIS**2, NODES_PER_AXIS, 1)
        d = node + GRID_MIN - self.x[:, None, :]

        nodes, flat = NODES_PER_AXIS**3, index.ravel()
        carried = (1 - DT * DRAG) * self.mass * self.v[:, None, :] + d @ B.transpose(0, 2, 1)
        momentum = weight[..., None] * carried
        grid_mass = self.mass * np.bincount(flat, weight.ravel(), nodes)
        grid_momentum = np.stack(
            [np.bincount(flat, momentum[..., a].ravel(), nodes) for a in range(3)], axis=-1
        )

        velocity = np.zeros_like(grid_momentum)
        occupied = grid_mass > MASS_FLOOR
        velocity[occupied] = grid_momentum[occupied] / grid_mass[occupied, None]

        share = weight[..., None] * velocity[index]
        v = share.sum(axis=1)
        C = INERTIA * (share.transpose(0, 2, 1) @ d)
        self.next = Layer(
            x=self.x + DT * v,
            v=v,
            C=C,
            F=(1 - SMOOTHING) * (identity + DT * C) @ A + SMOOTHING * self.F,
        )

    def result(self) -> Layer:
        """Return the layer after the scene's."""
        if self.next is None:
            raise RuntimeError("advance() comes first")
        return self.next


def cubic(d: np.ndarray) -> np.ndarray:
    """Cubic B-spline N(d)."""
    r = np.abs(d)
    return np.where(r < 1, r**3 / 2 - r**2 + 2 / 3, np.maximum(2 - r, 0) ** 3 / 6)
