"""Work in child processes on behalf of requests: few at the same time, ended with the service."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

import anyio

from chamfer_morph.server.http.problems import ProblemError

Meet = Callable[[subprocess.Popen[bytes]], None]
"""To be called with a child once it has started."""


@dataclass(eq=False)
class _Work:
    """Some work that waits for its turn or is under way."""

    path: Path
    ended: bool = False
    process: subprocess.Popen[bytes] | None = None

    def meet(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        if self.ended:
            process.kill()

    def end(self) -> None:
        self.ended = True
        if self.process is not None:
            self.process.kill()


class Children:
    """Child processes under way.

    Args:
        limit: How many at the same time; the others wait for their turn.
    """

    def __init__(self, limit: int) -> None:
        self._turn = asyncio.Semaphore(limit)
        self._threads = anyio.CapacityLimiter(limit)
        self._all: set[_Work] = set()
        self._closing = False

    async def run(
        self,
        path: Path,
        work: Callable[[Meet], None],
        is_wanted: Callable[[], Awaitable[bool]] | None = None,
    ) -> None:
        """Do some work when its turn has come.

        Args:
            path: What it makes.
            work: What runs the child; it blocks, in a thread of its own.
            is_wanted: Asked when its turn has come.

        Raises:
            ProblemError: 503, the service stops, or it is not wanted any more; 404, `end` was
                called.
            MorphError: As the work raises it.
        """
        one = _Work(path, ended=self._closing)
        self._all.add(one)
        try:
            async with self._turn:
                if is_wanted is not None and not await is_wanted():
                    raise ProblemError(503, "Nobody has waited for it.", "Ask for it again.")
                if not one.ended:
                    await anyio.to_thread.run_sync(work, one.meet, limiter=self._threads)
        except Exception:
            if not one.ended:
                raise
        finally:
            self._all.discard(one)
        if self._closing:
            raise ProblemError(
                503,
                "The service is stopping.",
                "Ask again in a few seconds.",
                headers={"Retry-After": "5"},
            )
        if one.ended:
            raise ProblemError(404, "It has been deleted meanwhile.", "Ask for it again.")

    def end(self, folder: Path) -> None:
        """End the work on everything in a folder, and that on a file where one is given."""
        for one in tuple(self._all):
            if one.path.is_relative_to(folder):
                one.end()

    def close(self) -> None:
        """End all of it."""
        self._closing = True
        for one in tuple(self._all):
            one.end()
