"""Heads that are too large or never end: what they are answered, when, and what they cost."""

from __future__ import annotations

import socket
import time
from contextlib import suppress

from benchmarks.service.local_service import (
    LocalService,
    forget_peak_memory,
    peak_memory,
    processes,
)
from benchmarks.service.measurement import Measurement, counted
from chamfer_morph.server.http.connection_limits import HEAD_BYTES, HEAD_SECONDS

COUNT = 100
BEGIN = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n"
ANSWER_SECONDS = 0.2
PAUSE_SECONDS = 0.1


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Send many large heads, then one a byte at a time."""
    headers = b"".join(b"x-%06d: %b\r\n" % (n, b"a" * 52) for n in range(HEAD_BYTES // 64 + 1))
    with service.served(0) as (api, supervisor):
        port = api.base_url.port
        assert port is not None
        (server,) = processes(supervisor, "chamfer_morph.server", "api")
        forget_peak_memory(server)
        before = peak_memory(server)
        answers = [answer(port, BEGIN + headers + b"\r\n") for _ in range(count)]
        grown = peak_memory(server) - before
        seconds = endless(port)
    others = sum(not each.startswith(b"HTTP/1.1 431 ") for each in answers)
    note = f"its deadline, and {ANSWER_SECONDS} s for the way"
    return [
        counted("other answers than 431", others, 0, f"of {count} heads of {HEAD_BYTES >> 10} KiB"),
        Measurement("memory of the API, grown by", grown / 1e6, None, "MB"),
        Measurement("an endless head ends", seconds, HEAD_SECONDS + ANSWER_SECONDS, "s", note),
    ]


def answer(port: int, head: bytes) -> bytes:
    """Everything that comes until the service closes the connection."""
    received = b""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as plain:
        with suppress(ConnectionError):
            plain.sendall(head)
        with suppress(ConnectionError):
            while piece := plain.recv(1 << 16):
                received += piece
    return received


def endless(port: int) -> float:
    """How long a head may last that comes byte by byte [s]."""
    with socket.create_connection(("127.0.0.1", port), timeout=PAUSE_SECONDS) as plain:
        began = time.monotonic()
        plain.sendall(BEGIN + b"X: ")
        with suppress(ConnectionError):
            while not answered(plain):
                plain.sendall(b"a")
        return time.monotonic() - began


def answered(plain: socket.socket) -> bool:
    """Whether an answer, or the end, comes before the timeout of a socket."""
    try:
        plain.recv(1 << 16)
    except TimeoutError:
        return False
    return True
