"""Files computed on request: each of them once, however many ask for it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import anyio
from starlette.requests import Request

from chamfer_morph.server.child_pool import Children, Meet
from chamfer_morph.server.waiters import Askers


class Derivations:
    """Files on their way.

    Args:
        limit: How many are computed at the same time.
    """

    def __init__(self, limit: int) -> None:
        self._children = Children(limit)
        self._tasks: dict[Path, asyncio.Task[None]] = {}
        self._askers: Askers[Path] = Askers()

    async def make(self, path: Path, compute: Callable[[Meet], None], request: Request) -> None:
        """Have a file computed unless it is there.

        What nobody waits for any more when its turn comes is not computed.

        Args:
            path: The file.
            compute: Computes it, in a child process.
            request: Who asks for it.

        Raises:
            ProblemError: 503, the service stops; 404, `end` was called.
            MorphError: As `compute` raises it.
        """
        if await anyio.Path(path).exists():
            return
        if path not in self._tasks:
            self._tasks[path] = asyncio.create_task(self._make(path, compute))
        self._askers.add(path, request)
        await asyncio.shield(self._tasks[path])

    def end(self, folder: Path) -> None:
        """End the computations of everything in a folder."""
        self._children.end(folder)

    def close(self) -> None:
        """End all computations."""
        self._children.close()

    async def _make(self, path: Path, compute: Callable[[Meet], None]) -> None:
        try:
            await self._children.run(path, compute, lambda: self._askers.wait_for(path))
        finally:
            del self._tasks[path]
            self._askers.forget(path)
