"""The particles every peer is timed on: a jittered lattice in a ball, moving and strained.

Lengths are grid units (dx = 1). The numbers are those of the published runs (algorithm 0); the ball
has the volume of their sphere, so three points per cell edge give their 37 thousand particles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]

BALL_RADIUS = 6.93
NODES_PER_AXIS = 33
GRID_MIN = -16.0
DT = 1.0 / 120.0
DRAG = 0.5
DENSITY = 75.0
LAMBDA = 38888.89
MU = 58333.3
SMOOTHING = 0.88
MASS_FLOOR = 1e-12
SEED = 42


@dataclass(frozen=True)
class Layer:
    """The moving part of a particle set at one time level.

    x [dx], v [dx/s]: shape [particle_count, 3]; C [1/s], F: shape [particle_count, 3, 3].
    """

    x: Array
    v: Array
    C: Array
    F: Array


@dataclass(frozen=True)
class Scene:
    """A layer with what a step needs besides: control U, rest volume [dx^3] and particle mass."""

    layer: Layer
    U: Array
    volume: Array
    mass: float

    @property
    def particle_count(self) -> int:
        """Number of particles."""
        return len(self.volume)


def ball(points_per_cell_edge: int = 3) -> Scene:
    """Return the scene, float32; 2, 3, 4, 5, 6 points make 11k, 38k, 89k, 174k, 301k particles."""
    rng = np.random.default_rng(SEED)
    spacing = 1.0 / points_per_cell_edge
    half = int(BALL_RADIUS / spacing) + 1
    ticks = np.arange(-half, half + 1) * spacing
    lattice = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice += rng.uniform(-0.1 * spacing, 0.1 * spacing, lattice.shape)
    x = lattice[np.linalg.norm(lattice, axis=1) < BALL_RADIUS]
    count = len(x)
    layer = Layer(
        x=x.astype(np.float32),
        v=rng.normal(0.0, 3.0, (count, 3)).astype(np.float32),
        C=rng.normal(0.0, 1.0, (count, 3, 3)).astype(np.float32),
        F=(np.eye(3) + rng.normal(0.0, 0.03, (count, 3, 3))).astype(np.float32),
    )
    return Scene(
        layer=layer,
        U=rng.normal(0.0, 0.01, (count, 3, 3)).astype(np.float32),
        volume=(spacing**3 * rng.uniform(0.8, 2.0, count)).astype(np.float32),
        mass=DENSITY * spacing**3,
    )
