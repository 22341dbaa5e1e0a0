"""What happened to a job, one JSON line per event; the line number is the event's id."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from chamfer_morph.schemas import Event

TAIL_BYTES = 1 << 14


@dataclass(frozen=True)
class EventLog:
    """The events of one job; one process appends, any number read.

    Attributes:
        path: The file, which need not exist yet.
    """

    path: Path

    def version(self) -> tuple[int, int]:
        """What changes with every event: when the file was written [ns], and its size [bytes]."""
        try:
            status = os.stat(self.path)
        except FileNotFoundError:
            return 0, 0
        return status.st_mtime_ns, status.st_size

    def append(self, type: str, data: dict[str, Any]) -> None:
        """Add an event, in one write, so that a kill leaves whole lines and at most one torn end.

        Raises:
            OSError: The disk refuses.
        """
        at = datetime.now(timezone.utc).isoformat()
        line = json.dumps({"at": at, "type": type, "data": _finite(data)}) + "\n"
        with self.path.open("a+b") as file:
            torn = file.tell() and os.pread(file.fileno(), 1, file.tell() - 1) != b"\n"
            file.write((b"\n" if torn else b"") + line.encode())

    def read(self, after: int = 0, limit: int = 1000) -> list[Event]:
        """Events with an id above `after`, the oldest first, at most `limit` of them."""
        events: list[Event] = []
        try:
            with self.path.open("rb") as file:
                for number, line in enumerate(file, 1):
                    if number > after and len(events) < limit:
                        events += _parsed(number, line)
        except FileNotFoundError:
            pass
        return events

    def tail(self) -> list[Event]:
        """The last events, the newest last; their ids are not known and given as 0."""
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                file.seek(max(size - TAIL_BYTES, 0))
                lines = file.read().splitlines(keepends=True)
        except FileNotFoundError:
            return []
        whole = lines if size <= TAIL_BYTES else lines[1:]
        return [event for line in whole for event in _parsed(0, line)]


def told_frames(events: Iterable[Event]) -> set[int]:
    """Indices of the frames that events tell of."""
    return {event.data["frame"] for event in events if event.type == "frame"}


def _parsed(number: int, line: bytes) -> list[Event]:
    """The event of a line; none if the line is torn."""
    if not line.endswith(b"\n"):
        return []
    try:
        return [Event.model_validate({"id": number, **json.loads(line)})]
    except (ValueError, TypeError):
        return []


def _finite(value: Any) -> Any:
    """JSON has no NaN and no infinity: leave such numbers out."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items() if not _is_not_finite(inner)}
    if isinstance(value, list | tuple):
        return [None if _is_not_finite(inner) else _finite(inner) for inner in value]
    return value


def _is_not_finite(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
