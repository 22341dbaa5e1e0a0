"""What is computed on request: once for all who ask, few at a time, and only while it is wanted."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import anyio
import pytest

from chamfer_morph.server import single_flight
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.single_flight import Flight, SingleFlight
from tests.patience import PATIENCE


class Waiting:
    """A request whose sender may leave."""

    gone = False

    async def is_disconnected(self) -> bool:
        """Whether the sender has left."""
        return self.gone


def running(test: Callable[[SingleFlight[Any]], Coroutine[Any, Any, None]]) -> None:
    """Run a test with a runner of one computation at a time, which remembers ten bytes."""

    async def main() -> None:
        turns = anyio.CapacityLimiter(1)
        await test(SingleFlight(lambda owner: turns, cache_bytes=10, size_of=len))

    asyncio.run(main())


def test_once_for_all_who_ask() -> None:
    """Three requests for the same wait for one computation; the last results are remembered."""
    calls = []

    def compute(flight: Flight[str]) -> str:
        calls.append(flight)
        return "result"

    async def test(runner: SingleFlight[str]) -> None:
        asked = [runner.get(("a", 1), compute, Waiting(), "") for _ in range(3)]
        assert await asyncio.gather(*asked) == ["result"] * 3 and len(calls) == 1
        assert await runner.get(("a", 1), compute, Waiting(), "") == "result" and len(calls) == 1
        await runner.get(("a", 2), compute, Waiting(), "")  # more than it remembers
        await runner.get(("a", 1), compute, Waiting(), "")
        assert len(calls) == 3

    running(test)


def test_what_nobody_waits_for_is_not_computed() -> None:
    """Who leaves before the turn comes costs nothing, unless somebody else waits for it, too."""
    computed = []
    held, left, shared = Waiting(), Waiting(), Waiting()
    begun, end = threading.Event(), threading.Event()

    def hold(_: Flight[str]) -> str:
        begun.set()
        end.wait(PATIENCE)
        return ""

    async def test(runner: SingleFlight[str]) -> None:
        first = asyncio.create_task(runner.get(("a",), hold, held, ""))
        await asyncio.to_thread(begun.wait, PATIENCE)
        waiting = [
            asyncio.create_task(
                runner.get((name,), lambda _, name=name: computed.append(name) or name, request, "")
            )
            for name, request in (("b", left), ("c", left), ("c", shared))
        ]
        await asyncio.sleep(0)
        left.gone = True
        end.set()
        await first
        results = await asyncio.gather(*waiting, return_exceptions=True)
        assert isinstance(results[0], ProblemError) and results[0].status_code == 503
        assert results[1:] == ["c", "c"] and computed == ["c"]

    running(test)


def test_cancelled_work_is_killed() -> None:
    """By the beginning of its key; who waits for it is told, and other work goes on."""

    def sleep(flight: Flight[str]) -> str:
        with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as process:
            flight.begin(process)
            flight.progress = 0.5
        return "ended"

    async def test(runner: SingleFlight[str]) -> None:
        asked = asyncio.create_task(runner.get(("job", 1), sleep, Waiting(), ""))
        queued = asyncio.create_task(runner.get(("other", 1), lambda _: "other", Waiting(), ""))
        while (flight := runner.find(("job", 1))) is None or not flight.progress:
            await asyncio.sleep(0.01)
        runner.cancel("job")
        assert runner.find(("job", 1)) is None
        with pytest.raises(ProblemError) as caught:
            await asyncio.wait_for(asked, PATIENCE)
        assert caught.value.status_code == 404 and await queued == "other"
        runner.close()
        with pytest.raises(ProblemError) as caught:
            await runner.get(("job", 2), sleep, Waiting(), "")
        assert caught.value.status_code == 503

    running(test)


def test_failures_of_what_nobody_waits_for_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until it is started again, cancelled, or there are too many; those of others are not."""
    monkeypatch.setattr(single_flight, "FAILURES_KEPT", 2)

    def fail(_: Flight[str]) -> str:
        raise ValueError("no")

    async def start(runner: SingleFlight[str], *key: int) -> None:
        runner.start(key, fail, "ann")
        while runner.count("ann"):
            await asyncio.sleep(0.01)

    async def test(runner: SingleFlight[str]) -> None:
        for number in range(4):
            await start(runner, number)
        kept = [number for number in range(4) if runner.find((number,))]
        assert kept == [1, 2, 3]  # two, and the one that was started last
        flight = runner.find((3,))
        assert flight is not None and isinstance(flight.error, ValueError)
        runner.start((3,), lambda _: "done", "ann")
        while runner.find((3,)):
            await asyncio.sleep(0.01)
        runner.cancel(2)
        assert runner.find((2,)) is None
        with pytest.raises(ValueError, match="no"):
            await runner.get((9,), fail, Waiting(), "")
        assert runner.find((9,)) is None

    running(test)
