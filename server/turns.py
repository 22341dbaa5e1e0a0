"""Turns at the children of this machine: keys in rotation, and each key's demands as they came."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager

import anyio

from chamfer_morph.worker.sandbox.budget import Budget, Demand, Ticket

POLL_SECONDS = 0.1
"""How often to look whether other processes have left room."""

Turn = Callable[[str], AbstractAsyncContextManager[object]]
"""Waits for a turn on the account of the key of a name, which lasts until the context is left."""


class Turns:
    """Hands out the budget of children within this process.

    Of each kind, a key has few children at a time, so that its own long ones do not hold up what it
    asks for in passing.

    Args:
        budget: What all processes share.
    """

    def __init__(self, budget: Budget) -> None:
        self._budget = budget
        self._waiting: dict[Ticket, asyncio.Future[None]] = {}
        self._changed = asyncio.Event()
        self._handing_out: asyncio.Task[None] | None = None
        self._threads = anyio.CapacityLimiter(math.inf)

    def kind(self, memory_bytes: int, *, at_once: int = 1, long: bool = False) -> Turn:
        """The turns of one kind of child.

        Args:
            memory_bytes: Memory that each may take [bytes].
            at_once: How many a key has at the same time.
            long: As of `Demand`.
        """
        lines: dict[str, anyio.CapacityLimiter] = {}

        @asynccontextmanager
        async def turn(owner: str) -> AsyncIterator[None]:
            line = lines.setdefault(owner, anyio.CapacityLimiter(at_once))
            async with line, self._turn(Demand(owner, memory_bytes, long)):
                yield

        return turn

    @asynccontextmanager
    async def _turn(self, demand: Demand) -> AsyncIterator[None]:
        ticket = await anyio.to_thread.run_sync(self._budget.enter, demand, limiter=self._threads)
        try:
            self._waiting[ticket] = begun = asyncio.get_running_loop().create_future()
            self._changed.set()
            if self._handing_out is None or self._handing_out.done():
                self._handing_out = asyncio.create_task(self._hand_out())
            await begun
            yield
        finally:
            self._waiting.pop(ticket, None)
            ticket.close()
            self._changed.set()

    async def _hand_out(self) -> None:
        """Give turns to those that wait, as long as there are any."""
        while self._waiting:
            self._changed.clear()
            try:
                begun = await anyio.to_thread.run_sync(
                    self._budget.begin, [*self._waiting], limiter=self._threads
                )
            except OSError as error:  # the disk refuses: so are those who wait
                for future in self._waiting.values():
                    if not future.done():
                        future.set_exception(error)
                return
            for ticket in begun:
                if (waiting := self._waiting.pop(ticket, None)) and not waiting.done():
                    waiting.set_result(None)
            with anyio.move_on_after(POLL_SECONDS):
                await self._changed.wait()
