"""Boxes of grid nodes, outside of which there is nothing to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class NodeBox:
    """The lowest nodes of a box along each axis, and one past the highest, shape [3] each."""

    low: NDArray[np.int64]
    high: NDArray[np.int64]

    @classmethod
    def whole(cls, resolution: int) -> NodeBox:
        """All nodes of a grid with so many along each axis."""
        return cls(np.zeros(3, np.int64), np.full(3, resolution))

    def union(self, other: NodeBox) -> NodeBox:
        """The least box that holds both."""
        return NodeBox(np.minimum(self.low, other.low), np.maximum(self.high, other.high))
