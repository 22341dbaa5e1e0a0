"""Reading of text/event-stream, as the HTML standard defines it (section 9.2)."""

from __future__ import annotations

import re
from dataclasses import dataclass

_LINE_END = re.compile(rb"\r\n|\n|\r")


@dataclass(frozen=True)
class Message:
    """One message of a stream.

    Attributes:
        id: Id of this message, or of the last one that had any.
        type: Its type, "message" where none is given.
        data: Its lines.
    """

    id: str
    type: str
    data: str


class EventStreamDecoder:
    """Takes the bytes of a stream as they arrive, in pieces of any size, and finds its messages."""

    def __init__(self) -> None:
        self._rest = b""
        self._id = ""
        self._type = ""
        self._data: list[str] = []

    def feed(self, chunk: bytes) -> list[Message]:
        """The messages that these bytes complete."""
        self._rest += chunk
        # a \r at the very end may be the first half of \r\n
        whole = len(self._rest) - self._rest.endswith(b"\r")
        *lines, rest = _LINE_END.split(self._rest[:whole])
        self._rest = rest + self._rest[whole:]
        return [message for line in lines if (message := self._take(line.decode())) is not None]

    def _take(self, line: str) -> Message | None:
        if not line:
            return self._dispatch()
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "data":
            self._data.append(value)
        elif name == "event":
            self._type = value
        elif name == "id" and "\0" not in value:
            self._id = value
        return None

    def _dispatch(self) -> Message | None:
        type_, data = self._type or "message", self._data
        self._type, self._data = "", []
        return Message(self._id, type_, "\n".join(data)) if data else None
