"""The body before a frame and after it, on the device."""

from typing import Any

import numpy as np

from morph_engine import backend
from morph_engine.array_copies import copy_to_front
from morph_engine.flow.body import Body, BodyPath
from morph_engine.flow.carrier import REFINEMENT
from morph_engine.flow.contact import Levels, extend
from morph_engine.flow.node_box import NodeBox
from morph_engine.mpm.grid import Grid


class BodyStates:
    """What kernels see of both states. Arrays are made once, and states change places.

    Args:
        path: What the bodies are of.
        grid: Its grid.

    Attributes:
        levels: Of the state before and the one after, in cells.
        masses: What nodes shall hold, before and after, see `Body`; device arrays, shape [r^3].
    """

    def __init__(self, path: BodyPath, grid: Grid) -> None:
        device = backend.active()
        self._edge = grid.dx
        points = int(path.size.prod())
        first, second, self._near = (device.scalars(points) for _ in range(3))
        box, self._near_box = (device.integers(6) for _ in range(2))
        box.from_numpy(np.concatenate([path.corner, path.size]).astype(np.int32))
        self.levels: Any = Levels(now=first, then=second, box=box)
        self._exchanged: Any = Levels(now=second, then=first, box=box)
        self.masses: list[Any] = [device.scalars(grid.node_count) for _ in range(2)]
        self._boxes = [NodeBox.whole(grid.resolution)] * 2

    @property
    def box(self) -> NodeBox:
        """The nodes that shall hold matter before or after."""
        return self._boxes[0].union(self._boxes[1])

    def exchange(self) -> None:
        """Let the state after be the one before."""
        self.levels, self._exchanged = self._exchanged, self.levels
        self.masses.reverse()
        self._boxes.reverse()

    def set_before(self, body: Body) -> None:
        """Take a body as the state before."""
        self._set(0, self.levels.now, body)

    def set_after(self, body: Body) -> None:
        """Take a body as the state after."""
        self._set(1, self.levels.then, body)

    def _set(self, state: int, level: Any, body: Body) -> None:
        real, near = backend.active().numpy_real, body.level.values
        copy_to_front(self._near, near.ravel() / real(self._edge))
        self._near_box.from_numpy(np.array([*body.level.corner, *near.shape], np.int32))
        extend(self._near, self._near_box, level, self.levels.box, 1 / REFINEMENT)
        self.masses[state].from_numpy(body.mass.ravel().astype(real, copy=False))
        self._boxes[state] = body.box
