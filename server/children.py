"""Work in child processes on behalf of requests: few at the same time, ended with the service."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Awaitable, Callable

import anyio

from server.problems import ProblemError

Meet = Callable[[subprocess.Popen[bytes]], None]
"""To be called with a child once it has started."""


class Children:
    """Child processes under way.

    Args:
        limit: How many at the same time; the others wait for their turn.
    """

    def __init__(self, limit: int) -> None:
        self._turn = asyncio.Semaphore(limit)
        self._threads = anyio.CapacityLimiter(limit)
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._closing = False

    async def run(
        self, work: Callable[[Meet], None], is_wanted: Callable[[], Awaitable[bool]] | None = None
    ) -> None:
        """Do some work when its turn has come.

        Args:
            work: What runs the child; it blocks, in a thread of its own.
            is_wanted: Asked when its turn has come.

        Raises:
            ProblemError: 503, the service stops, or it is not wanted any more.
            MorphError: As the work raises it.
        """
        try:
            async with self._turn:
                if is_wanted is not None and not await is_wanted():
                    raise ProblemError(503, "Nobody has waited for it.", "Ask for it again.")
                if not self._closing:
                    await anyio.to_thread.run_sync(work, self._meet, limiter=self._threads)
        except Exception:
            if not self._closing:
                raise
        finally:
            self._processes = {p for p in self._processes if p.poll() is None}
        if self._closing:
            raise ProblemError(
                503,
                "The service is stopping.",
                "Ask again in a few seconds.",
                headers={"Retry-After": "5"},
            )

    def close(self) -> None:
        """End all of them."""
        self._closing = True
        for process in tuple(self._processes):
            process.kill()

    def _meet(self, process: subprocess.Popen[bytes]) -> None:
        self._processes.add(process)
        if self._closing:
            process.kill()
