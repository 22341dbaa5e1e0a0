"""Previews of shapes, the last few of which are kept."""

from __future__ import annotations

from collections import OrderedDict

import anyio

from worker.job import Fit
from worker.preview import Preview, sample_shape
from worker.settings import Settings

KEPT = 8


class Previews:
    """Samples shapes in child processes.

    Args:
        settings: Memory and CPU time of a child.
        children: Limits how many there are at the same time.
    """

    def __init__(self, settings: Settings, children: anyio.CapacityLimiter) -> None:
        self._settings = settings
        self._children = children
        self._kept: OrderedDict[tuple[str, int, Fit], Preview] = OrderedDict()

    async def get(self, shape: str, name: str, points_per_cell_edge: int, fit: Fit) -> Preview:
        """The particles of a shape; arguments and errors as of `sample_shape`."""
        key = (shape, points_per_cell_edge, fit)
        preview = self._kept.pop(key, None)
        if preview is None:
            preview = await anyio.to_thread.run_sync(
                sample_shape,
                shape,
                name,
                points_per_cell_edge,
                fit,
                self._settings,
                limiter=self._children,
            )
        self._kept[key] = preview
        while len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return preview
