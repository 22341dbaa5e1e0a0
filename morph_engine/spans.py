"""Spans: parts of a run that take time, nested, and told to whoever listens.

They are its stages, its frames, and what is within these: `filling` shapes with particles,
`preparing` the method and in it `matching` like parts, `computing` a leg and in it each `frame`,
`measuring` the end, `writing` the result.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class SpanListener(Protocol):
    """Hears of spans in their order; each ends before the one that it lies in."""

    def begin(self, name: str, attributes: Mapping[str, int]) -> None:
        """A span begins."""

    def end(self) -> None:
        """The span that began last, and has not ended, ends."""


_listener: ContextVar[SpanListener | None] = ContextVar("span_listener", default=None)


def listen(listener: SpanListener) -> None:
    """Tell a listener of the spans of this context from now on."""
    _listener.set(listener)


@contextmanager
def span(name: str, **attributes: int) -> Iterator[None]:
    """Tell the listener, if there is one, what goes on meanwhile."""
    listener = _listener.get()
    if listener is None:
        yield
        return
    listener.begin(name, attributes)
    try:
        yield
    finally:
        listener.end()
