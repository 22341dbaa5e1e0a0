"""Traces: one from the request to the frames of its job, over all processes of a service."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from chamfer_morph.client import MorphClient
from tests.acceptance.conftest import POSTGRES_BY_FAULT_TESTS
from tests.collector import PATIENCE, Collector, collecting
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


def only(spans: list[Any]) -> Any:
    """The one that is there."""
    (found,) = spans
    return found


def frame_numbers(spans: list[Any]) -> list[int]:
    """Which frames spans are of."""
    return [span.attributes["morph.frame"] for span in spans]


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

    stranger = {"Authorization": "Bearer unknown"}
    assert service.call("POST", "/v1/jobs/none/cancel", headers=stranger).status_code == 401
    service.stop()
    log = (service.data_dir / "service.log").read_text().splitlines()
    lines = [json.loads(line) for line in log if line.startswith("{")]
    told = {line["message"]: line for line in lines if line.get("job") == job.id}
    assert told["begins"]["trace_id"] == told["done"]["trace_id"] == trace
    assert told["begins"]["span_id"] == run.span_id
    refused = only([line for line in lines if line.get("status") == 401])
    cancel = only(collector.named("POST /v1/jobs/{job_id}/cancel"))
    assert (refused["trace_id"], refused["span_id"]) == (cancel.trace_id, cancel.span_id)


def test_a_job_of_a_killed_worker_goes_on_in_its_trace(
    new_service: Callable[..., LiveService], collector: Collector
) -> None:
    """What came of the lost run and all of the next one have the trace of the request.

    A frame that ends in the moment before the kill may not have been sent any more.
    """
    service = new_service(**traced(collector))
    job = service.submit(method="flow", frames=60)
    collector.wait_for(lambda: len(collector.named("frame")) > 2, "frames of the first run")
    os.kill(worker_of(service), signal.SIGKILL)
    assert service.wait_for(job, "succeeded", "failed", seconds=PATIENCE)["state"] == "succeeded"
    collector.wait_for(lambda: bool(collector.named("job")), "the job's span")

    request, run = only(collector.named("POST /v1/jobs")), only(collector.named("job"))
    of_job = ("queue", "job", "attempt", "preparing", "computing", "frame", "writing")
    assert {span.trace_id for name in of_job for span in collector.named(name)} == {
        request.trace_id
    }
    assert run.parent_id == request.span_id
    first, second = collector.named("queue")
    attempt, computing = only(collector.named("attempt")), only(collector.named("computing"))
    assert attempt.attributes["morph.attempt"] == 2
    assert (attempt.parent_id, computing.parent_id) == (run.span_id, attempt.span_id)
    frames = collector.named("frame")
    lost = [span for span in frames if span.parent_id != computing.span_id]
    computed = [span for span in frames if span.parent_id == computing.span_id]
    assert frame_numbers(lost) == list(range(len(lost)))
    assert frame_numbers(computed) == list(range(60 - len(computed), 60))
    assert 60 - len(computed) >= len(lost) - 1 > 1  # at most one frame is computed again
    assert first.end <= lost[0].begin < lost[-1].end <= second.end <= run.begin + 10**9


@POSTGRES_BY_FAULT_TESTS
def test_a_killed_engine_and_a_resumed_job(
    new_service: Callable[..., LiveService], collector: Collector, database_url: str
) -> None:
    """The next attempt lies beside the failed one; a resumed job is linked with what resumed it."""
    service = new_service(**traced(collector), MORPH_DATABASE_URL=database_url)
    job = service.submit(method="flow", frames=60)
    collector.wait_for(lambda: len(collector.named("frame")) > 2, "frames of the first run")
    os.kill(engine_of(service), signal.SIGKILL)
    collector.wait_for(lambda: bool(collector.named("attempt")), "the failed attempt")
    assert service.call("POST", f"/v1/jobs/{job}/cancel").is_success
    assert service.wait_for(job, "cancelled", "succeeded")["state"] == "cancelled"
    collector.wait_for(lambda: bool(collector.named("job")), "the cancelled run")
    assert service.call("POST", f"/v1/jobs/{job}/resume").is_success
    service.wait_for(job, "succeeded", seconds=PATIENCE)
    collector.wait_for(lambda: len(collector.named("job")) == 2, "the resumed run")

    request = only(collector.named("POST /v1/jobs"))
    first, resumed = collector.named("job")
    assert first.parent_id == resumed.parent_id == request.span_id
    assert first.trace_id == resumed.trace_id == request.trace_id
    resume = only(collector.named("POST /v1/jobs/{job_id}/resume"))
    assert (first.links, resumed.links) == ((), (resume.span_id,))
    failed = collector.named("attempt")[0]
    broken = only([span for span in collector.named("computing") if span.begin < failed.end])
    assert failed.failed and failed.parent_id == first.span_id
    assert broken.failed and broken.parent_id == failed.span_id
    wait = collector.named("queue")[1]
    assert wait.parent_id == request.span_id and resume.begin <= wait.begin <= resumed.begin


def test_a_worker_that_is_stopped_ends_its_spans(
    new_service: Callable[..., LiveService], collector: Collector
) -> None:
    """The spans of the run that it leaves are there, as failed."""
    service = new_service(**traced(collector))
    service.submit(method="flow", frames=400)
    collector.wait_for(lambda: len(collector.named("frame")) > 2, "frames")
    service.stop()
    collector.wait_for(lambda: bool(collector.named("job")), "the job's span")
    run, attempt = only(collector.named("job")), only(collector.named("attempt"))
    computing = only(collector.named("computing"))
    assert run.failed and attempt.failed and computing.failed
    assert (attempt.parent_id, computing.parent_id) == (run.span_id, attempt.span_id)


def test_nothing_is_imported_without_the_variables(new_service: Callable[..., LiveService]) -> None:
    """No process of a service has loaded OpenTelemetry's SDK or an exporter."""
    service = new_service(PYTHONPROFILEIMPORTTIME="1")
    service.wait_for(service.submit(), "succeeded", seconds=PATIENCE)
    service.stop()
    log = (service.data_dir / "service.log").read_text()
    assert "fastapi" in log and "dbos" in log  # it does tell what is imported
    assert "opentelemetry.sdk" not in log and "opentelemetry.exporter" not in log


def test_it_says_what_to_install(tmp_path: Path) -> None:
    """Without the extra, a process that is asked for traces names it, and goes on."""
    program = (
        "import sys; sys.modules['opentelemetry.sdk.trace'] = None; "
        "from chamfer_morph.worker import telemetry; "
        "telemetry.set_up('morph-api'); assert not telemetry.is_on()"
    )
    said = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:4318"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "pip install 'chamfer-morph[telemetry]'" in said.stderr
    assert len(said.stderr.splitlines()) == 1


def children_of(service: LiveService, module: str) -> list[psutil.Process]:
    """Processes of a service that run a module."""
    assert service._process is not None
    found = psutil.Process(service._process.pid).children(recursive=True)
    return [child for child in found if module in child.cmdline()]


def worker_of(service: LiveService) -> int:
    """The process of its worker slot."""
    (pid,) = [c.pid for c in children_of(service, "chamfer_morph.worker") if "run" in c.cmdline()]
    return pid


def engine_of(service: LiveService) -> int:
    """The engine process that has a job: it writes its messages into the directory of that."""
    engines = children_of(service, "chamfer_morph.worker.engine_process")
    (pid,) = [e.pid for e in engines if any("/jobs/" in file.path for file in e.open_files())]
    return pid
