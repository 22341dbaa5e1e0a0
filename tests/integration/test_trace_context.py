"""Which trace the requests of a client belong to."""

from __future__ import annotations

import pytest
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.trace import format_span_id, format_trace_id

from chamfer_morph.client import MorphClient
from tests.web_server import running

GIVEN = f"00-{'1a' * 16}-{'2b' * 8}-01"
QUEUE = b'{"owner": "", "paused": false, "queued": 0, "running": 0}'


def sent() -> str | None:
    """The header `traceparent` of a request of the blocking client."""
    with running() as server:
        server.files["v1/queue"] = QUEUE
        with MorphClient(server.url) as client:
            client.queue()
        ((_, headers),) = server.requests
    return headers.get("traceparent")


def test_none_is_named_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor by what is no traceparent."""
    monkeypatch.delenv("TRACEPARENT", raising=False)
    assert sent() is None
    monkeypatch.setenv("TRACEPARENT", "made up\n")
    assert sent() is None


def test_that_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """TRACEPARENT goes through as it is."""
    monkeypatch.setenv("TRACEPARENT", GIVEN)
    assert sent() == GIVEN


def test_that_of_the_active_span(monkeypatch: pytest.MonkeyPatch) -> None:
    """The caller's span goes before the environment, also into the thread of the client."""
    monkeypatch.setenv("TRACEPARENT", GIVEN)
    with TracerProvider(shutdown_on_exit=False).get_tracer("a").start_as_current_span("b") as span:
        context = span.get_span_context()
        ids = format_trace_id(context.trace_id), format_span_id(context.span_id)
        assert sent() == "00-{}-{}-{:02x}".format(*ids, context.trace_flags)
