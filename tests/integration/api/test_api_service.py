"""The whole service in real processes, a morph from submit to result."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest
import trimesh

from morph_engine.results.trajectory import Trajectory
from tests.patience import PATIENCE, until

JOB: dict[str, Any] = {
    "source": {"shape": "sphere"},
    "target": {"shape": "star"},
    "method": "dco",
    "overrides": {"sampling.points_per_cell_edge": 1},
    "frames": 3,
}


@dataclass
class Service:
    """A running service.

    Attributes:
        process: The supervisor.
        http: A client of its API.
        data: Its data directory.
    """

    process: subprocess.Popen[str]
    http: httpx.Client
    data: Path

    def wait(self, job: str, *states: str) -> dict[str, Any]:
        """The job, once it is in one of these states."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            try:
                found: dict[str, Any] = self.http.get(f"/v1/jobs/{job}").json()
            except httpx.TransportError:  # an open connection does not outlive its API
                continue
            if found["state"] in states:
                return found
            time.sleep(0.1)
        raise AssertionError(found)

    def children(self, word: str) -> list[psutil.Process]:
        """Processes of the supervisor with a word in their command line."""
        return [
            child
            for child in psutil.Process(self.process.pid).children()
            if word in child.cmdline()
        ]


@pytest.fixture
def service(database_url: str, tmp_path: Path) -> Iterator[Service]:
    """The service with one worker slot, on SQLite and on Postgres."""
    environment = os.environ | {
        "MORPH_DATA_DIR": str(tmp_path / "data"), "MORPH_DATABASE_URL": database_url,
        "MORPH_PORT": "0", "MORPH_WORKERS": "1", "MORPH_WARM_ENGINES": "false",
    }  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-m", "chamfer_morph.server", "serve"],
        env=environment, cwd=tmp_path, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr
    try:
        for line in process.stderr:
            if found := re.search(r"http://\S+", line):
                break
        else:
            pytest.fail("the service ended before it answered")
        with httpx.Client(base_url=found[0], timeout=PATIENCE) as http:
            yield Service(process, http, tmp_path / "data")
    finally:
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
        process.stderr.close()


def test_a_morph_from_submit_to_result(service: Service, tmp_path: Path) -> None:
    """Watched to its end, fetched in parts, cancelled, resumed, retried; then all ends in peace."""
    job = service.http.post("/v1/jobs", json=JOB).json()["id"]
    events = []
    headers = {"Accept": "text/event-stream"}
    with service.http.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as stream:
        for line in stream.iter_lines():
            if line.startswith("data: "):
                events.append(json.loads(line.removeprefix("data: ")))
    assert [event["data"]["frame"] for event in events if event["type"] == "frame"] == [0, 1, 2]
    assert events[-1]["data"] == {"state": "succeeded"}
    shown = service.http.get(f"/v1/jobs/{job}").json()
    path = f"/v1/jobs/{job}/result"
    whole = service.http.get(path)
    digest = hashlib.sha256(whole.content).hexdigest()
    assert shown["outcome"]["sha256"] == digest == whole.headers["ETag"].strip('"')
    half = len(whole.content) // 2
    rest = service.http.get(
        path, headers={"Range": f"bytes={half}-", "If-Range": whole.headers["ETag"]}
    )
    assert rest.status_code == 206 and rest.content == whole.content[half:]
    known = {"If-None-Match": whole.headers["ETag"]}
    assert service.http.get(path, headers=known).status_code == 304
    beyond = service.http.get(path, headers={"Range": "bytes=999999999-"})
    assert beyond.status_code == 416 and beyond.json()["status"] == 416
    file = tmp_path / "result.vtkhdf"
    file.write_bytes(whole.content)
    with Trajectory(file) as trajectory:
        frame = service.http.get(f"/v1/jobs/{job}/frames/1").content
        assert frame == trajectory.positions(1).astype("<f4").tobytes()
    assert [row["frame"] for row in service.http.get(f"/v1/jobs/{job}/metrics").json()] == [0, 1, 2]

    long = service.http.post("/v1/jobs", json=JOB | {"frames": 4000}).json()["id"]
    service.wait(long, "running")
    until(lambda: service.http.get(f"/v1/jobs/{long}").json()["progress"]["frame"] >= 2)
    slot = service.http.get("/v1/workers").json()[0]
    assert slot["alive"] and slot["job"] == long
    assert service.http.get(f"/v1/jobs/{long}/frames/0").status_code == 200
    assert service.http.post(f"/v1/jobs/{long}/cancel").status_code == 202
    service.wait(long, "cancelled")
    until(lambda: service.http.get(f"/v1/jobs/{long}/result").status_code == 200)
    partial = service.http.get(f"/v1/jobs/{long}/result")
    assert hashlib.sha256(partial.content).hexdigest() == partial.headers["ETag"].strip('"')
    assert service.http.post(f"/v1/jobs/{long}/resume").status_code == 202
    service.wait(long, "running")
    service.http.post(f"/v1/jobs/{long}/cancel")
    service.wait(long, "cancelled")

    assert service.http.post(f"/v1/jobs/{job}/retry").status_code == 202
    assert service.wait(job, "succeeded")["outcome"]["sha256"]
    assert service.http.delete(f"/v1/jobs/{job}").status_code == 204

    processes = psutil.Process(service.process.pid).children(recursive=True)
    service.process.send_signal(signal.SIGINT)
    assert service.process.wait(PATIENCE) == 0
    assert not psutil.wait_procs(processes, timeout=PATIENCE)[1]


def test_what_dies_is_started_again(service: Service) -> None:
    """A killed API answers again on the same port, a killed worker goes on with its job."""
    job = service.http.post("/v1/jobs", json=JOB | {"frames": 100}).json()["id"]
    service.children("api")[0].kill()
    while not service.wait(job, "running")["progress"]["frame"]:
        time.sleep(0.05)
    service.children("run")[0].kill()
    assert service.wait(job, "succeeded")["progress"]["frame"] == 100
    processes = psutil.Process(service.process.pid).children(recursive=True)
    service.process.kill()
    service.process.wait()
    assert not psutil.wait_procs(processes, timeout=PATIENCE)[1], "nothing outlives its supervisor"


def test_an_api_killed_between_upload_and_queue(service: Service) -> None:
    """Files that came in are kept; the request repeated under its key is one job, and runs."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=7)
    job = {name: value for name, value in JOB.items() if name != "source"}
    form: dict[str, Any] = {
        "data": {"job": json.dumps(job)},
        "files": {"source": ("ball.ply", mesh.export(file_type="ply"))},
        "headers": {"Idempotency-Key": "once"},
    }
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(service.http.post, "/v1/jobs", **form)
        until(lambda: any((service.data / "meshes").glob("*/report.json")) or first.done())
        service.children("api")[0].kill()
        with suppress(httpx.TransportError):
            first.result()
    answer = _repeated(lambda: service.http.post("/v1/jobs", **form))
    assert answer.status_code in (200, 202), answer.text
    assert [job["id"] for job in service.http.get("/v1/jobs").json()["items"]] == [
        answer.json()["id"]
    ]
    assert len(service.http.get("/v1/meshes").json()["items"]) == 1
    service.wait(answer.json()["id"], "succeeded")


def _repeated(send: Callable[[], httpx.Response]) -> httpx.Response:
    """The answer to a request that is sent until there is one."""
    while True:
        with suppress(httpx.TransportError):
            return send()
        time.sleep(0.1)
