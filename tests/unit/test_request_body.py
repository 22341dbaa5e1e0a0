"""Bodies that come slowly: the silence between two pieces counts, and the time of all of them."""

from __future__ import annotations

import asyncio

import pytest
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import Message, Receive, Scope, Send

from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.http.request_body import BodyLimitMiddleware

LIMIT_SECONDS = 3600.0
DEADLINE_SECONDS = 10 * LIMIT_SECONDS


class LeapingLoop(asyncio.SelectorEventLoop):
    """An event loop whose clock can be moved.

    Attributes:
        ahead: By how much it is before the clock of the machine [s].
    """

    ahead = 0.0

    def time(self) -> float:
        """The time [s]."""
        return super().time() + self.ahead


def upload(pieces: int, pause_seconds: float) -> bytes:
    """What arrives of a body whose pieces of one byte come with pauses, on the loop's clock."""
    arrived: list[bytes] = []
    left = pieces

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        arrived.append(await Request(scope, receive).body())
        await PlainTextResponse("")(scope, receive, send)

    async def receive() -> Message:
        nonlocal left
        left -= 1
        loop.ahead += pause_seconds
        await asyncio.sleep(0.01)  # in which the deadlines that are over come
        return {"type": "http.request", "body": b"#", "more_body": left > 0}

    async def send(message: Message) -> None:
        pass

    limited = BodyLimitMiddleware(
        app,
        timeout_seconds=LIMIT_SECONDS,
        deadline_seconds=DEADLINE_SECONDS,
        max_bytes=1000,
        exceptions={},
    )
    scope: Scope = {"type": "http", "method": "POST", "path": "/", "headers": []}
    loop = LeapingLoop()
    try:
        loop.run_until_complete(limited(scope, receive, send))
    finally:
        loop.close()
    return arrived[0]


def test_slow_is_not_stalled() -> None:
    """Pieces within the limit of each other are waited for, until the deadline."""
    assert upload(pieces=10, pause_seconds=LIMIT_SECONDS / 2) == b"#" * 10


def test_a_longer_silence_is_not_waited_for() -> None:
    """It is answered 408."""
    with pytest.raises(ProblemError) as caught:
        upload(pieces=2, pause_seconds=2 * LIMIT_SECONDS)
    assert caught.value.status_code == 408


def test_a_trickle_ends() -> None:
    """What comes piece by piece, always in time, is answered 408 at the deadline."""
    with pytest.raises(ProblemError) as caught:
        upload(pieces=1000, pause_seconds=LIMIT_SECONDS / 2)
    assert caught.value.status_code == 408 and "36000 s" in caught.value.detail
