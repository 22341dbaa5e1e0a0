"""Traces: one from the request to the frames of its job, over all processes of a service."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from chamfer_morph.client import MorphClient
from tests.collector import Collector, SeenSpan, collecting
from tests.live_service import LiveService, free_port

FRAMES = 4


@pytest.fixture
def collector() -> Iterator[Collector]:
    """A collector."""
    with collecting() as found:
        yield found


@pytest.fixture
def new_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., LiveService]]:
    """Starts a service with more environment variables."""
    started = []

    def start(**variables: str) -> LiveService:
        service = LiveService(tmp_path, free_port())
        environment = service.environment | {"MORPH_LOG_FORMAT": "json"} | variables
        monkeypatch.setattr(LiveService, "environment", property(lambda _: environment))
        service.start()
        started.append(service)
        return service

    yield start
    for service in started:
        service.stop()


def traced(collector: Collector) -> dict[str, str]:
    """The variables that let processes send traces to a collector, soon."""
    return {"OTEL_EXPORTER_OTLP_ENDPOINT": collector.url, "OTEL_BSP_SCHEDULE_DELAY": "100"}


def only(spans: list[SeenSpan]) -> SeenSpan:
    """The one span."""
    (found,) = spans
    return found


def test_one_trace_from_the_request_to_the_frames(
    new_service: Callable[..., LiveService],
    collector: Collector,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every span has the client's trace and its proper parent; log lines name them."""
    service = new_service(**traced(collector))
    trace, caller = secrets.token_hex(16), secrets.token_hex(8)
    monkeypatch.setenv("TRACEPARENT", f"00-{trace}-{caller}-01")
    overrides = {"sampling.points_per_cell_edge": 1}
    with MorphClient(service.url) as client:
        job = client.submit("sphere", "star", frames=FRAMES, overrides=overrides)
        assert client.wait(job.id).state == "succeeded"
    collector.wait_for(lambda: bool(collector.named("job")), "the job's span")

    request = only(collector.named("POST /v1/jobs"))
    queue, run = only(collector.named("queue")), only(collector.named("job"))
    attempt = only(collector.named("attempt"))
    filling, preparing = only(collector.named("filling")), only(collector.named("preparing"))
    matching = only(collector.named("matching"))
    computing, writing = only(collector.named("computing")), only(collector.named("writing"))
    frames, measuring = collector.named("frame"), only(collector.named("measuring"))
    parents = {
        request: caller,
        queue: request.span_id,
        run: request.span_id,
        attempt: run.span_id,
        **dict.fromkeys((filling, preparing, computing, writing), attempt.span_id),
        matching: preparing.span_id,
        **dict.fromkeys(frames, computing.span_id),
        measuring: frames[-1].span_id,
    }
    for span, parent in parents.items():
        assert (span.trace_id, span.parent_id) == (trace, parent), span
        assert not span.failed and span.begin <= span.end, span
    assert [frame.attributes["morph.frame"] for frame in frames] == list(range(FRAMES))
    assert request.begin <= queue.begin <= queue.end <= attempt.begin
    assert filling.end <= preparing.begin <= preparing.end <= computing.begin
    assert computing.end <= writing.begin <= writing.end <= attempt.end <= run.end
    assert request.attributes["http.response.status_code"] == 202
    assert {span.attributes["morph.job.id"] for span in (request, queue, run)} == {job.id}
    assert (request.service, run.service) == ("morph-api", "morph-worker")

    service.stop()
    log = (service.data_dir / "service.log").read_text().splitlines()
    lines = [json.loads(line) for line in log if line.startswith("{")]
    told = {line["message"]: line for line in lines if line.get("job") == job.id}
    assert told["begins"]["trace_id"] == told["done"]["trace_id"] == trace
    assert told["begins"]["span_id"] == run.span_id
