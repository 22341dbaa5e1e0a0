"""A shape by its size alone: its volume, its bounding box, and which way it stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.sampling import Similarity
from morph_engine.geometry.upward import Up


@dataclass(frozen=True, eq=False)
class Solid:
    """What placing a shape needs to know of it, in its own coordinates.

    Attributes:
        volume: Enclosed volume.
        bounds: Lower and upper corner of the bounding box, shape [2, 3], float64.
        built_in: Whether it is a built-in shape, in grid units, and not a file of the user's.
        up: The axis that points upwards in it; None where nothing tells.
    """

    volume: float
    bounds: npt.NDArray[np.float64]
    built_in: bool = False
    up: Up | None = None

    @classmethod
    def of(cls, mesh: Mesh) -> Solid:
        """That of a mesh."""
        return cls(mesh.volume, mesh.bounds, mesh.built_in, mesh.up)

    def turned(self, turn: Similarity) -> Solid:
        """The same turned, its bounding box being that of its turned box."""
        return self if turn == Similarity() else replace(self, bounds=turn.box(self.bounds))
