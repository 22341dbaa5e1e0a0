"""The log as JSON: from a request to what became of its job, over all processes of a service."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import pytest

from tests.live_service import LiveService, free_port
from tests.patience import until

SECRET = "0123456789abcdef" * 2

SMALL = {
    "source": {"shape": "sphere"},
    "target": {"shape": "star"},
    "frames": 2,
    "overrides": {"sampling.points_per_cell_edge": 1},
}
"""A job that takes seconds."""


@pytest.fixture
def log_format() -> str:
    """The format of the service's log."""
    return "json"


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, log_format: str):
    """A service with a key."""
    found = LiveService(tmp_path, free_port())
    environment = found.environment | {"MORPH_LOG_FORMAT": log_format, "MORPH_ADMIN_KEY": SECRET}
    monkeypatch.setattr(LiveService, "environment", property(lambda _: environment))
    found.start()
    yield found
    found.stop()


def test_a_job_can_be_followed(service: LiveService) -> None:
    """The request names the job; the worker says when it began and was done, and by which request;
    no line is text.
    """  # noqa: D205
    key = {"Authorization": f"Bearer {SECRET}"}
    body = SMALL | {"method": "dco"}
    made = service.call("POST", "/v1/jobs", json=body, headers=key | {"X-Request-ID": "click-1"})
    job = made.json()["id"]
    events = f"{service.url}/v1/jobs/{job}/events"
    with httpx.stream(
        "GET", events, headers=key | {"Accept": "text/event-stream"}, timeout=600
    ) as stream:
        for _ in stream.iter_lines():  # ends with the job
            pass
    assert service.call("GET", f"/v1/jobs/{job}", headers=key).json()["state"] == "succeeded"
    again = key | {"X-Request-ID": "click-2"}
    assert service.call("POST", f"/v1/jobs/{job}/retry", headers=again).status_code == 202
    with httpx.stream(
        "GET", events, headers=key | {"Accept": "text/event-stream"}, timeout=600
    ) as stream:
        for _ in stream.iter_lines():
            pass
    service.stop()
    log = (service.data_dir / "service.log").read_text()
    lines = [json.loads(line) for line in log.splitlines() if line.startswith("{")]
    told = [(line["logger"].rpartition(".")[2], line["message"]) for line in lines if
            line.get("job") == job]  # fmt: skip
    assert told == 2 * [("audit", "request"), ("jobs", "begins"), ("jobs", "done")]
    about = [line for line in lines if line.get("job") == job]
    assert [line["request"] for line in about] == 3 * ["click-1"] + 3 * ["click-2"]
    request, begun, *_ = about
    assert request["status"] == 202
    assert begun["attempt"] == 1 and begun["worker"]
    assert SECRET not in log


@pytest.mark.parametrize("log_format", ["text", "json"])
def test_a_failed_job_is_one_line(service: LiveService, log_format: str) -> None:
    """It names the job and why, without a traceback; as JSON like every other line."""
    key = {"Authorization": f"Bearer {SECRET}"}
    far = {"landmarks": [{"source": [90, 90, 90], "target": [0, 0, 0]}]}
    body = SMALL | {"method": "flow", "overrides": SMALL["overrides"] | far}
    made = service.call("POST", "/v1/jobs", json=body, headers=key)
    assert made.is_success, made.text
    address = f"/v1/jobs/{made.json()['id']}"
    until(lambda: service.call("GET", address, headers=key).json()["state"] == "failed")
    problem = service.call("GET", address, headers=key).json()["problem"]
    service.stop()
    _, _, log = (service.data_dir / "service.log").read_text().partition("(Ctrl-C stops it).\n")
    assert "Traceback" not in log
    line = f"job {made.json()['id']} has failed: {problem['cause']}"
    if log_format == "text":
        assert len([found for found in log.splitlines() if problem["cause"] in found]) == 1
        assert line in log
        return
    lines = [json.loads(found) for found in log.splitlines()]
    failed = [found for found in lines if found["message"] == line]
    assert [(found["job"], found["kind"]) for found in failed] == [(made.json()["id"], "input")]
