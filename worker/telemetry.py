"""Traces by OpenTelemetry, where its standard variables ask for them; else nothing is imported.

Traces belong to processes that call `set_up`. A trace goes from one process to another as a
carrier: the headers `traceparent` and `tracestate` of W3C Trace Context.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from opentelemetry import trace
    from opentelemetry.context import Context
    from opentelemetry.sdk.trace import TracerProvider

Attributes = Mapping[str, str | int | float]
Kind = Literal["internal", "consumer"]

CARRIED = ("traceparent", "tracestate")
"""What a carrier may have."""

ENDPOINTS = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")
PROTOCOLS = ("OTEL_EXPORTER_OTLP_TRACES_PROTOCOL", "OTEL_EXPORTER_OTLP_PROTOCOL")

FLUSH_SECONDS = 2.0
"""What a process that ends waits for its last spans to be sent."""

FRAME_SPANS = 256
"""Frames of a job that have a span, at most: of more, they are evenly spaced."""

log: logging.Logger = logging.getLogger(__name__)

_provider: TracerProvider | None = None
_tracer: trace.Tracer | None = None
_open: set[trace.Span] = set()


def set_up(service: str) -> None:
    """Trace this process if OTEL_* variables ask for it.

    Args:
        service: Its name in traces, unless OTEL_SERVICE_NAME gives another.
    """
    global _provider, _tracer
    if not _is_wanted():
        return
    protocol = next(filter(None, map(os.environ.get, PROTOCOLS)), "http/protobuf")
    if protocol != "http/protobuf":
        log.warning("No traces: only OTLP over http/protobuf is supported, not %s.", protocol)
        return
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import OTELResourceDetector, Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ModuleNotFoundError:
        log.warning(
            "OTEL_* variables request traces, which need another package: pip install "
            "'chamfer-morph[telemetry]'."
        )
        return
    logging.getLogger("opentelemetry.exporter").setLevel(logging.ERROR)  # not of each repetition
    named = OTELResourceDetector().detect().attributes
    resource = Resource.create({"service.name": service, **named})
    _provider = TracerProvider(resource=resource, shutdown_on_exit=False)  # which may take long
    _provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    _tracer = _provider.get_tracer("chamfer_morph")


def _is_wanted() -> bool:
    if os.environ.get("OTEL_SDK_DISABLED", "").strip().lower() == "true":
        return False
    if exporters := os.environ.get("OTEL_TRACES_EXPORTER", ""):
        return "otlp" in map(str.strip, exporters.split(","))
    return any(os.environ.get(name) for name in ENDPOINTS)


def is_on() -> bool:
    """Whether this process is traced."""
    return _tracer is not None


def provider() -> TracerProvider | None:
    """Where spans come from, for libraries that make some themselves; None without traces."""
    return _provider


def flush() -> None:
    """End all spans as failed and send them, before this process ends; waits not long."""
    for span in list(_open):
        _end_as_broken(span, "The process ended.")
    if _provider is not None:
        sending = threading.Thread(target=_provider.force_flush, daemon=True)
        sending.start()
        sending.join(FLUSH_SECONDS)


@contextmanager
def span(
    name: str,
    attributes: Attributes | None = None,
    *,
    parent: Mapping[str, str] | None = None,
    link: Mapping[str, str] | None = None,
    kind: Kind = "internal",
) -> Iterator[None]:
    """A span around what follows, which is failed if that raises.

    Args:
        name: Its name.
        attributes: Its attributes.
        parent: Carrier of its parent; the active span if not given. One that is empty, or makes no
            sense, begins a trace.
        link: Carrier of another span that has to do with it.
        kind: Its part in a conversation between processes.
    """
    if _tracer is None:
        yield
        return
    from opentelemetry.trace import Link, SpanKind, get_current_span

    linked = get_current_span(_context(link)).get_span_context() if link else None
    with _tracer.start_as_current_span(
        name,
        context=None if parent is None else _context(parent),
        kind=SpanKind[kind.upper()],
        attributes=attributes,
        links=[Link(linked)] if linked and linked.is_valid else None,
    ) as started:
        _open.add(started)
        try:
            yield
        finally:
            _open.discard(started)


def record(
    name: str, begin: int, end: int, attributes: Attributes, parent: Mapping[str, str]
) -> None:
    """A span that is over.

    Args:
        name: Its name.
        begin: When it began [ns since 1970].
        end: When it ended [ns since 1970].
        attributes: Its attributes.
        parent: Carrier of its parent.
    """
    if _tracer is not None:
        past = _tracer.start_span(name, _context(parent), attributes=attributes, start_time=begin)
        past.end(max(begin, end))


def annotate(attributes: Attributes) -> None:
    """Add attributes to the active span, if there is one."""
    if _tracer is not None:
        from opentelemetry.trace import get_current_span

        get_current_span().set_attributes(attributes)


def carrier() -> dict[str, str]:
    """What lets another process go on with the active span; empty where there is none."""
    found: dict[str, str] = {}
    if _tracer is not None:
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        TraceContextTextMapPropagator().inject(found)
    return found


def carried(values: Mapping[str, object]) -> dict[str, str]:
    """The carrier among other values."""
    return {name: str(values[name]) for name in CARRIED if name in values}


def ids() -> dict[str, str]:
    """`trace_id` and `span_id` of the active span; empty where there is none."""
    if _tracer is None:
        return {}
    from opentelemetry.trace import format_span_id, format_trace_id, get_current_span

    active = get_current_span().get_span_context()
    if not active.is_valid:
        return {}
    return {
        "trace_id": format_trace_id(active.trace_id),
        "span_id": format_span_id(active.span_id),
    }


class EngineSpans:
    """Spans that an engine process tells of, below the span that is active when this is made.

    The engine itself, which reads what strangers have sent, knows no collector and no secret of
    one. What has not ended when it dies, ends as failed.

    Args:
        frame_count: Frames of its job.
    """

    def __init__(self, frame_count: int) -> None:
        from opentelemetry.context import get_current

        self._outside = get_current()
        self._stride = -(-frame_count // FRAME_SPANS)
        self._open: list[trace.Span | None] = []  # none where a frame has no span

    def begin(self, name: str, at: int, attributes: Mapping[str, int]) -> None:
        """A span has begun, at a time in nanoseconds since 1970."""
        if _tracer is None or (name == "frame" and attributes["frame"] % self._stride):
            self._open.append(None)
            return
        named = {f"morph.{key}": value for key, value in attributes.items()}
        started = _tracer.start_span(name, self._innermost(), attributes=named, start_time=at)
        _open.add(started)
        self._open.append(started)

    def end(self, at: int) -> None:
        """The innermost span has ended, at a time in nanoseconds since 1970."""
        if self._open and (ended := self._open.pop()):
            _open.discard(ended)
            ended.end(at)

    def close(self) -> None:
        """The engine is gone."""
        while self._open:
            if broken := self._open.pop():
                _end_as_broken(broken, "The engine ended.")

    def _innermost(self) -> Context:
        from opentelemetry.trace import set_span_in_context

        found = next((span for span in reversed(self._open) if span), None)
        return set_span_in_context(found, self._outside) if found else self._outside


def _end_as_broken(span: trace.Span, why: str) -> None:
    from opentelemetry.trace import Status, StatusCode

    _open.discard(span)
    span.set_status(Status(StatusCode.ERROR, why))
    span.end()


def _context(carrier: Mapping[str, str]) -> Context:
    """The context of a carrier, apart from whatever is active here."""
    from opentelemetry.context import Context
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    return TraceContextTextMapPropagator().extract(carrier, Context())
