"""When there are traces; spans of an engine as its worker records them, and as it tells of them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextvars import copy_context

import pytest
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from chamfer_morph.worker import telemetry
from chamfer_morph.worker.telemetry import FRAME_SPANS, EngineSpans
from morph_engine.spans import listen, span


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> Iterator[InMemorySpanExporter]:
    """What is recorded, in the order of the ends."""
    exporter = InMemorySpanExporter()
    provider = TracerProvider(shutdown_on_exit=False)
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    monkeypatch.setattr(telemetry, "_tracer", provider.get_tracer("test"))
    yield exporter
    provider.shutdown()


@pytest.mark.parametrize(
    ("variables", "on"),
    [
        ({}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": ""}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:9"}, True),
        ({"OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": "http://127.0.0.1:9/v1/traces"}, True),
        ({"OTEL_TRACES_EXPORTER": "otlp"}, True),
        ({"OTEL_TRACES_EXPORTER": "none", "OTEL_EXPORTER_OTLP_ENDPOINT": "http://h:9"}, False),
        ({"OTEL_SDK_DISABLED": "true", "OTEL_EXPORTER_OTLP_ENDPOINT": "http://h:9"}, False),
        ({"OTEL_EXPORTER_OTLP_PROTOCOL": "grpc", "OTEL_TRACES_EXPORTER": "otlp"}, False),
    ],
)
def test_what_turns_them_on(
    variables: dict[str, str], on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The standard variables, and nothing else."""
    for name in [name for name in os.environ if name.startswith("OTEL_")]:
        monkeypatch.delenv(name)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(telemetry, "_tracer", None)
    monkeypatch.setattr(telemetry, "_provider", None)
    telemetry.set_up("morph-test")
    assert telemetry.is_on() == on
    if provider := telemetry.provider():
        assert provider.resource.attributes["service.name"] == "morph-test"
        provider.shutdown()


def parents(spans: tuple[ReadableSpan, ...]) -> list[tuple[str, str | None]]:
    """The names of spans and of their parents."""
    names = {each.context.span_id: each.name for each in spans}
    return [(each.name, names[each.parent.span_id] if each.parent else None) for each in spans]


def test_they_lie_in_each_other(recorded: InMemorySpanExporter) -> None:
    """The times are the engine's; the outermost lie in the span that was active before."""
    with telemetry.span("attempt"):
        spans = EngineSpans(2)
    spans.begin("computing", 10, {"leg": 0})
    spans.begin("frame", 20, {"frame": 0})
    spans.end(30)
    spans.end(40)
    found = recorded.get_finished_spans()
    assert parents(found) == [("attempt", None), ("frame", "computing"), ("computing", "attempt")]
    assert [(each.start_time, each.end_time) for each in found[1:]] == [(20, 30), (10, 40)]
    assert dict(found[1].attributes or {}) == {"morph.frame": 0}


@pytest.mark.parametrize("frames", [1, FRAME_SPANS, FRAME_SPANS + 1, 10000])
def test_so_many_frames_at_most(frames: int, recorded: InMemorySpanExporter) -> None:
    """What lies in a frame without a span goes to the span around that."""
    spans = EngineSpans(frames)
    spans.begin("computing", 0, {"leg": 0})
    for frame in range(frames):
        spans.begin("frame", 0, {"frame": frame})
        if frame == frames - 1:
            spans.begin("measuring", 0, {})
            spans.end(1)
        spans.end(1)
    spans.end(2)
    found = recorded.get_finished_spans()
    count = sum(each.name == "frame" for each in found)
    assert min(frames, FRAME_SPANS) / 2 <= count <= FRAME_SPANS
    last = found[-1] if (frames - 1) % -(-frames // FRAME_SPANS) else found[-2]
    measuring = next(each for each in found if each.name == "measuring")
    assert measuring.parent and measuring.parent.span_id == last.context.span_id


def test_what_a_dead_engine_leaves_has_failed(recorded: InMemorySpanExporter) -> None:
    """All of it ends."""
    spans = EngineSpans(1)
    spans.begin("computing", 0, {"leg": 0})
    spans.begin("frame", 0, {"frame": 0})
    spans.close()
    found = recorded.get_finished_spans()
    assert [(each.name, each.status.is_ok) for each in found] == [
        ("frame", False),
        ("computing", False),
    ]


def test_the_engine_tells_a_listener() -> None:
    """Also of the end of what fails."""
    told: list[object] = []

    class Listener:
        def begin(self, name, attributes):
            told.append((name, dict(attributes)))

        def end(self):
            told.append("end")

    def fail():
        listen(Listener())
        with span("computing", leg=1), span("frame", frame=3):
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        copy_context().run(fail)
    assert told == [("computing", {"leg": 1}), ("frame", {"frame": 3}), "end", "end"]
