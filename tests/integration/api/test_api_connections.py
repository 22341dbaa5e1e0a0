"""Heads of requests have a size and an age, and slow connections leave room for others."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import pairwise

import httpx
import pytest

from chamfer_morph.server.http import connection_limits
from chamfer_morph.server.http.connection_limits import HEAD_BYTES, LimitedProtocol
from tests.integration.api.conftest import Api
from tests.patience import PATIENCE, until


@contextmanager
def connection(api: Api) -> Iterator[socket.socket]:
    """A connection to the API that speaks no HTTP by itself."""
    url = httpx.URL(str(api.http.base_url))
    with socket.create_connection((url.host, url.port), timeout=PATIENCE) as plain:
        yield plain


def answer(plain: socket.socket) -> bytes:
    """Everything that comes until the API closes the connection."""
    received = b""
    with suppress(ConnectionError):
        while piece := plain.recv(1 << 16):
            received += piece
    return received


def flood(plain: socket.socket, piece: bytes, most: int = 64 << 20) -> int:
    """Send a piece again and again; how much has been taken when the API closes [bytes]."""
    sent = 0
    with suppress(ConnectionError):
        while sent < most:
            plain.sendall(piece)
            sent += len(piece)
    return sent


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """One second for a head."""
    monkeypatch.setattr(connection_limits, "HEAD_SECONDS", 1.0)


@pytest.mark.parametrize(
    "begin",
    [b"GET /", b"GET / HTTP/1.1\r\nHost: x\r\nX: ", b"GET /livez HTTP/1.1\r\n\r\nGET /?"],
)
def test_an_endless_head_is_refused(api: Api, begin: bytes) -> None:
    """Neither an address nor a header is taken beyond the limit."""
    with connection(api) as plain:
        plain.sendall(begin)
        assert flood(plain, b"a" * 4096) < 16 << 20  # what the system buffers on the way
    assert api.http.get("/livez").status_code == 200


def test_many_headers_are_refused_with_a_reason(api: Api) -> None:
    """431, as a problem; a head just below the limit is taken."""
    for count, status in ((HEAD_BYTES // 64 - 8, b"200"), (HEAD_BYTES // 64 + 1, b"431")):
        headers = b"".join(b"x-%06d: %b\r\n" % (i, b"a" * 52) for i in range(count))
        with connection(api) as plain:
            plain.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n")
            plain.sendall(headers + b"\r\n")
            received = answer(plain)
        assert received.startswith(b"HTTP/1.1 " + status), received[:200]
    assert b"/problems/headers-too-large" in received


def test_endless_trailers_are_cut_off(api: Api) -> None:
    """A header behind the body in chunks is no way around the limit."""
    with connection(api) as plain:
        plain.sendall(
            b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"
            b"Content-Type: application/json\r\n\r\n2\r\n{}\r\n0\r\nx: "
        )
        assert flood(plain, b"a" * 4096) < 16 << 20


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("begun", [b"", b"GET /livez HTTP/1.1\r\nHost: x\r\n", b"GET /livez"])
def test_a_head_that_does_not_come_is_not_waited_for(api: Api, begun: bytes) -> None:
    """The connection ends at its deadline, with 408 where something has come."""
    with connection(api) as plain:
        plain.sendall(begun)
        received = answer(plain)
    assert received.startswith(b"HTTP/1.1 408") if begun else not received


@pytest.mark.usefixtures("impatient")
def test_the_rest_of_an_answered_body_is_not_waited_for(api: Api) -> None:
    """Who is refused cannot keep the connection by sending on, byte by byte."""
    with connection(api) as plain:
        plain.sendall(b"POST /nowhere HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000\r\n\r\n{")
        assert answer(plain).startswith(b"HTTP/1.1 40")


@pytest.mark.usefixtures("impatient")
def test_a_slow_body_and_a_second_request_are_taken(api: Api) -> None:
    """The deadline is for heads alone, and each has its own."""
    body = b'{"source": {"shape": "sphere"}, "target": {"shape": "star"}}'
    head = (
        b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Content-Length: %d\r\n" % len(body)
    )
    with connection(api) as plain:
        for last in (b"\r\n", b"Connection: close\r\n\r\n"):
            plain.sendall(head + last + body[:9])
            with connection(api) as later:
                assert not answer(later), "its deadline is over, and so is any that began before"
            plain.sendall(body[9:])
            if last == b"\r\n":
                assert plain.recv(1 << 16).startswith(b"HTTP/1.1 202")
        assert answer(plain).startswith(b"HTTP/1.1 202")


def test_slow_connections_leave_room(
    make_api: Callable[..., Api], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where there are too many connections, the one that waits longest ends."""
    monkeypatch.setattr(connection_limits, "most_connections", lambda: 50)
    api = make_api()
    with ExitStack() as stack:
        slow = [stack.enter_context(connection(api)) for _ in range(120)]
        for plain in slow:
            with suppress(ConnectionError):
                plain.sendall(b"GET /livez HTTP/1.1\r\nX: ")
        assert api.http.get("/livez").status_code == 200
        assert not answer(slow[0])


def test_idle_connections_leave_room(
    make_api: Callable[..., Api], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that have been answered and are kept for another request end for others, too."""
    LimitedProtocol.waiting.clear()  # those of other tests
    monkeypatch.setattr(connection_limits, "most_connections", lambda: 50)
    api = make_api()
    request = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with ExitStack() as stack:
        idle = [stack.enter_context(connection(api)) for _ in range(50)]
        for plain in [*idle, idle[0]]:
            plain.sendall(request)
            assert plain.recv(1 << 16).startswith(b"HTTP/1.1 200")
        for _ in range(20):
            newcomer = stack.enter_context(connection(api))
            newcomer.sendall(request)
            assert newcomer.recv(1 << 16).startswith(b"HTTP/1.1 200")
        assert not answer(idle[1]), "it has been idle for longest"
        idle[0].sendall(request)
        assert idle[0].recv(1 << 16).startswith(b"HTTP/1.1 200"), "it has asked again since"


@pytest.mark.usefixtures("impatient")
def test_late_connections_end_one_at_a_time(api: Api) -> None:
    """Whoever else wants something comes in between, however many are late at once."""
    LimitedProtocol.waiting.clear()  # those of other tests
    with ExitStack() as stack:
        slow = [stack.enter_context(connection(api)) for _ in range(50)]
        for plain in slow:
            plain.sendall(b"GET /livez HTTP/1.1\r\nX: ")
        until(lambda: len(LimitedProtocol.waiting) == len(slow), "They are not accepted.")
        held = [*LimitedProtocol.waiting]
        loop, ended = held[0].loop, [0]

        def count() -> None:
            ended.append(sum(each.transport.is_closing() for each in held))
            if ended[-1] < len(held):
                loop.call_soon(count)

        loop.call_soon_threadsafe(time.sleep, 1.5)  # after that all of them are late
        loop.call_soon_threadsafe(count)
        assert all(answer(plain).startswith(b"HTTP/1.1 408") for plain in slow)
    assert max(after - before for before, after in pairwise(ended)) == 1
