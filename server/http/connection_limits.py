"""What a connection may cost before anybody knows whose it is: bytes of a head, time, a socket.

uvicorn takes a head (the address and headers of a request) of any size and age.
"""

from __future__ import annotations

import asyncio
import sys
from collections import deque
from functools import cache
from typing import Any, ClassVar

from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from chamfer_morph.server.http.problems import ProblemError

HEAD_BYTES = 64 << 10
"""Largest head, give or take what else comes in the same packet [bytes]."""

HEAD_SECONDS = 10.0
"""Time for a whole head, and for the rest of a body whose request has been answered [s]."""

FRAMING_FREE_BYTES = 1 << 20
FRAMING_SHARE = 16
"""A body in chunks may have so many bytes of framing for each of its first bytes; the trailers of
an endless request would count as such."""

SPARE_FILES = 256
"""Open files that are not for connections: those of the database, of uploads, of children."""


class LimitedProtocol(HttpToolsProtocol):
    """A connection with limits.

    Attributes:
        waiting: The connections that wait for a head: for the first one, or for the next one once a
            request is answered. Those that have waited longest come first.
        late: The connections whose time was over when their timers said so. They end one at a time,
            and what else there is to do comes in between: thousands may be late at once.
    """

    waiting: ClassVar[dict[LimitedProtocol, None]] = {}
    late: ClassVar[deque[tuple[LimitedProtocol, asyncio.TimerHandle | None]]] = deque()

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._in_head = True
        self._head_bytes = 0
        self._body_bytes = 0
        self._framing_bytes = 0
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection; where there are too many, the one that waits longest ends."""
        super().connection_made(transport)
        self.waiting[self] = None
        self._begin_deadline()
        if len(self.connections) > most_connections():
            longest = next(iter(self.waiting))
            del self.waiting[longest]
            longest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget a connection."""
        self.waiting.pop(self, None)
        self._end_deadline()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse what comes, as far as it may."""
        if self._in_head:
            data = self._receive_head(data)
        if data and not self.transport.is_closing():
            self._receive_body(data)

    def on_headers_complete(self) -> None:
        """A whole head is there."""
        self._in_head = False
        self._head_bytes = self._body_bytes = self._framing_bytes = 0
        self.waiting.pop(self, None)
        self._end_deadline()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """A piece of a body."""
        self._body_bytes += len(body)
        self._framing_bytes -= len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """A whole request is there; what comes now is the head of the next."""
        self._in_head = True
        self._end_deadline()
        super().on_message_complete()
        self._wait_if_idle()

    def on_response_complete(self) -> None:
        """A request is answered; nobody needs what it has not sent yet."""
        super().on_response_complete()
        if not self._in_head:
            self._begin_deadline()
        self._wait_if_idle()

    def _wait_if_idle(self) -> None:
        """Get in line where all requests that have come are answered."""
        if self._in_head and self.cycle.response_complete and not self.transport.is_closing():
            self.waiting[self] = None

    def _receive_head(self, data: bytes) -> bytes:
        """Parse as much as a head may have; what lies behind it is returned."""
        self._begin_deadline()
        room = HEAD_BYTES - self._head_bytes
        super().data_received(data[:room])
        if not self._in_head:
            return data[room:]
        self._head_bytes += len(data)
        if self._head_bytes >= HEAD_BYTES:
            self._refuse(
                431,
                f"The URL and headers are larger than {HEAD_BYTES >> 10} KiB.",
                "Send a shorter URL and fewer headers, for instance fewer cookies.",
            )
        return b""

    def _receive_body(self, data: bytes) -> None:
        self._framing_bytes += len(data)
        super().data_received(data)
        body = min(self._body_bytes, FRAMING_FREE_BYTES)
        if not self._in_head and self._framing_bytes > HEAD_BYTES + FRAMING_SHARE * body:
            self.transport.abort()

    def _begin_deadline(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(HEAD_SECONDS, self._get_in_line)

    def _end_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _get_in_line(self) -> None:
        """Its time is over."""
        self.late.append((self, self._deadline))
        if len(self.late) == 1:
            self.loop.call_soon(self._end_next)

    def _end_next(self) -> None:
        """End the connection that has been late for longest, and later the next one."""
        connection, deadline = self.late.popleft()
        if self.late:
            self.loop.call_soon(self._end_next)
        if connection._deadline is deadline:  # else what it was waited for has come just now
            connection._end_late()

    def _end_late(self) -> None:
        if self.transport.is_closing():
            return
        if self._in_head and self._head_bytes:
            self._refuse(
                408,
                f"The headers did not arrive within {HEAD_SECONDS:g} s.",
                "Send the request again, over a more stable connection.",
            )
        else:
            self.transport.close()

    def _refuse(self, status: int, detail: str, remedy: str) -> None:
        """Answer what never becomes a request, and close the connection."""
        if self.cycle is None or self.cycle.response_complete:
            self.transport.write(_refusal(status, detail, remedy))
        self.transport.close()


@cache
def _refusal(status: int, detail: str, remedy: str) -> bytes:
    """A whole answer, the last one of a connection."""
    answer = ProblemError(status, detail, remedy).response()
    lines = [b"%b: %b\r\n" % header for header in answer.raw_headers]
    head = [STATUS_LINE[status], *lines, b"connection: close\r\n\r\n"]
    return b"".join(head) + bytes(answer.body)


def most_connections() -> int:
    """Connections that the open files of this process allow."""
    if sys.platform == "win32":
        return 512 - SPARE_FILES
    import resource

    return max(resource.getrlimit(resource.RLIMIT_NOFILE)[0] - SPARE_FILES, 16)


def allow_many_files() -> None:
    """Raise the number of open files to what the system allows this process."""
    if sys.platform == "win32":
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 1 << 16 if hard == resource.RLIM_INFINITY else min(hard, 1 << 16)
    if soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
