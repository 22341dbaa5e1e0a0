"""What is computed on request: each thing once, however many ask for it, when its turn has come."""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

import anyio
from starlette.requests import Request

from chamfer_morph.server.http.problems import ProblemError, unavailable
from chamfer_morph.server.turns import Turn
from chamfer_morph.worker.sandbox.runner import Computation

Result = TypeVar("Result")
Key = tuple[Hashable, ...]

FAILURES_KEPT = 100


class Flight(Computation, Generic[Result]):
    """A computation that waits for its turn or is under way, or one that has failed.

    Attributes:
        owner: Name of the key on whose account it is.
        error: Why it has failed, if it has.
        requests: Who waits for it; None where it is computed in any case.
    """

    def __init__(self, owner: str, requests: list[Request] | None) -> None:
        super().__init__()
        self.owner = owner
        self.error: Exception | None = None
        self.requests = requests
        self.task: asyncio.Task[Result] | None = None

    async def is_wanted(self) -> bool:
        """Whether anybody still waits for it."""
        if self.requests is None:
            return True
        for request in self.requests:
            # the first look may only find the end of the request itself
            if not (await request.is_disconnected() or await request.is_disconnected()):
                return True
        return False


Compute = Callable[[Flight[Result]], Result]
"""Computes something; blocks, in a thread of its own. It tells its flight of its child process."""


class SingleFlight(Generic[Result]):
    """Computations of one kind, by key.

    A key is a tuple; what it begins with, such as the id of a job, is what can be cancelled at one
    stroke.

    Args:
        turn: Waits until one may begin, on the account of the key of a name.
        cache_bytes: How much of the last results is remembered [bytes].
        size_of: The size of a result [bytes].
    """

    def __init__(
        self,
        turn: Turn,
        *,
        cache_bytes: int = 0,
        size_of: Callable[[Result], int] = lambda result: 1,
    ) -> None:
        self._turn = turn
        self._threads = anyio.CapacityLimiter(math.inf)
        self._flights: dict[Key, Flight[Result]] = {}
        self._cache: OrderedDict[Key, Result] = OrderedDict()
        self._cache_bytes = cache_bytes
        self._size_of = size_of
        self._closing = False

    async def get(self, key: Key, compute: Compute[Result], request: Request, owner: str) -> Result:
        """Wait for a result.

        What nobody waits for any more when its turn comes is not computed.

        Args:
            key: What it follows from.
            compute: Computes it.
            request: Who waits for it.
            owner: Name of the key on whose account it is, if it is not under way.

        Raises:
            ProblemError: 503, the service stops; 404, it was cancelled.
            Exception: As `compute` raises it.
        """
        if key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        flight = self._flights.get(key) or self._start(key, compute, Flight(owner, []))
        assert flight.task is not None and flight.requests is not None
        flight.requests.append(request)
        return await asyncio.shield(flight.task)

    def start(self, key: Key, compute: Compute[Result], owner: str) -> None:
        """Begin with a computation, unless it is under way; nobody has to wait for it.

        Its failure is remembered until it is started again or cancelled.
        """
        known = self._flights.get(key)
        if known is None or known.error is not None:
            failed = [key for key, flight in self._flights.items() if flight.error is not None]
            for oldest in failed[: max(len(failed) - FAILURES_KEPT, 0)]:
                del self._flights[oldest]
            self._start(key, compute, Flight(owner, None))

    def find(self, key: Key) -> Flight[Result] | None:
        """A computation that is under way, or was started and has failed."""
        return self._flights.get(key)

    def count(self, owner: str) -> int:
        """Number of computations on account of an owner that have not ended."""
        return sum(f.owner == owner and f.error is None for f in tuple(self._flights.values()))

    def cancel(self, *prefix: Hashable) -> None:
        """End and forget the computations whose keys begin so."""
        for key in list(self._flights):  # other threads may add to it
            if key[: len(prefix)] == prefix and (flight := self._flights.pop(key, None)):
                flight.cancel()

    def close(self) -> None:
        """End all of them, now and from now on."""
        self._closing = True
        self.cancel()

    def _start(self, key: Key, compute: Compute[Result], flight: Flight[Result]) -> Flight[Result]:
        self._flights[key] = flight
        flight.cancelled = self._closing
        flight.task = asyncio.create_task(self._run(key, compute, flight))
        flight.task.add_done_callback(lambda task: task.cancelled() or task.exception())
        return flight

    async def _run(self, key: Key, compute: Compute[Result], flight: Flight[Result]) -> Result:
        try:
            async with self._turn(flight.owner):
                if not await flight.is_wanted():
                    raise ProblemError(503, "Nobody was waiting for it.", "Request it again.")
                if flight.cancelled:
                    raise self._ended()
                result = await anyio.to_thread.run_sync(compute, flight, limiter=self._threads)
            if flight.cancelled:
                raise self._ended()
        except Exception as error:
            flight.error = self._ended() if flight.cancelled else error
            raise flight.error from None
        finally:
            forgotten = flight.error is None or flight.requests is not None
            if forgotten and self._flights.get(key) is flight:
                self._flights.pop(key, None)
        self._remember(key, result)
        return result

    def _ended(self) -> ProblemError:
        """What to tell those who wait for something that is cancelled."""
        if self._closing:
            return unavailable("The service is stopping.")
        return ProblemError(404, "It has been deleted in the meantime.", "Request it again.")

    def _remember(self, key: Key, result: Result) -> None:
        if not self._cache_bytes:
            return
        self._cache[key] = result
        while sum(map(self._size_of, self._cache.values())) > self._cache_bytes:
            self._cache.popitem(last=False)
