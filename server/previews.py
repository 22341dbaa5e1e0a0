"""Previews of shapes: each computed once, however many ask for it, and the last of them kept."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from pathlib import Path
from typing import NamedTuple

import anyio
from starlette.requests import Request

from chamfer_morph.schemas import Fit
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.waiters import Askers
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.tasks.sample_shape import Preview, sample_shape

KEPT_BYTES = 64 << 20


class _Wanted(NamedTuple):
    """What decides over a preview."""

    shape: Path | str
    points_per_cell_edge: int
    fit: Fit


class Previews:
    """Samples shapes in child processes.

    Args:
        settings: Memory and CPU time of a child.
        limit: How many there are at the same time.
    """

    def __init__(self, settings: Settings, limit: int) -> None:
        self._settings = settings
        self._turn = asyncio.Semaphore(limit)
        self._threads = anyio.CapacityLimiter(limit)
        self._askers: Askers[_Wanted] = Askers()
        self._running: dict[_Wanted, asyncio.Task[Preview]] = {}
        self._kept: OrderedDict[_Wanted, Preview] = OrderedDict()

    async def get(
        self,
        shape: Path | str,
        name: str,
        points_per_cell_edge: int,
        fit: Fit,
        request: Request,
    ) -> Preview:
        """The particles of a shape; arguments and errors as of `sample_shape`.

        What the request, and all others for the same, no longer wait for when its turn comes is
        not computed.

        Raises:
            ProblemError: 503, nobody has waited for it.
        """
        wanted = _Wanted(shape, points_per_cell_edge, fit)
        if wanted in self._kept:
            self._kept.move_to_end(wanted)
            return self._kept[wanted]
        if wanted not in self._running:
            self._running[wanted] = asyncio.create_task(self._sample(wanted, name))
        self._askers.add(wanted, request)
        return await asyncio.shield(self._running[wanted])

    async def _sample(self, wanted: _Wanted, name: str) -> Preview:
        shape, points_per_cell_edge, fit = wanted
        try:
            async with self._turn:
                if not await self._askers.wait_for(wanted):
                    raise ProblemError(503, "Nobody has waited for it.", "Ask for it again.")
                preview = await anyio.to_thread.run_sync(
                    sample_shape,
                    shape,
                    name,
                    points_per_cell_edge,
                    fit,
                    self._settings,
                    limiter=self._threads,
                )
        finally:
            del self._running[wanted]
            self._askers.forget(wanted)
        self._kept[wanted] = preview
        while sum(kept.positions.nbytes for kept in self._kept.values()) > KEPT_BYTES:
            self._kept.popitem(last=False)
        return preview
