"""`morph serve` in a process of its own, for tests of what talks to it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.patience import PATIENCE

START_SECONDS = 180
"""How long the service may take to start; it imports the engine, on a machine that may be busy."""

SHAPES = {"source": {"shape": "sphere"}, "target": {"shape": "star"}}
COARSE = {"sampling.points_per_cell_edge": 1}


@dataclass
class LiveService:
    """`morph serve` in a folder of its own.

    Attributes:
        data_dir: Where it keeps its things.
        port: Where it listens, also after a restart.
        workers: Worker slots.
    """

    data_dir: Path
    port: int
    workers: int = 1
    _process: subprocess.Popen[bytes] | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        """Its settings as environment variables."""
        own = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
        return own | {
            "MORPH_DATA_DIR": str(self.data_dir),
            "MORPH_PORT": str(self.port),
            "MORPH_WORKERS": str(self.workers),
            "MORPH_THREADS": "1",
        }

    def start(self) -> None:
        """Start it and wait until it answers."""
        with (self.data_dir / "service.log").open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "chamfer_morph.server", "serve"],
                env=self.environment,
                stdout=log,
                stderr=log,
            )
        deadline = time.monotonic() + START_SECONDS
        while time.monotonic() < deadline:
            try:
                if self.call("GET", "/readyz").is_success:
                    return
            except httpx.TransportError:
                time.sleep(0.1)
        pytest.fail((self.data_dir / "service.log").read_text(errors="replace")[-3000:])

    def stop(self) -> None:
        """Stop it as a user does."""
        if self._process is not None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(PATIENCE)
            finally:
                self._process.kill()

    def call(self, method: str, path: str, **request: Any) -> httpx.Response:
        """Call the API."""
        return httpx.request(method, self.url + path, timeout=30, **request)

    def submit(self, **request: Any) -> str:
        """Queue a small job, sphere to star in three frames if nothing else is said."""
        body = {"method": "physics", "frames": 3, "overrides": COARSE, **SHAPES} | request
        answer = self.call("POST", "/v1/jobs", json=body)
        assert answer.is_success, answer.text
        return str(answer.json()["id"])

    def pause_queue(self) -> None:
        """Let jobs wait that have not begun."""
        assert self.call("POST", "/v1/queue/pause").is_success

    def unpause_queue(self) -> None:
        """Let them begin."""
        assert self.call("POST", "/v1/queue/unpause").is_success

    def job(self, job_id: str) -> dict[str, Any]:
        """A job as it stands."""
        shown: dict[str, Any] = self.call("GET", f"/v1/jobs/{job_id}").json()
        return shown

    def wait_for(self, job_id: str, *states: str, seconds: float = 180) -> dict[str, Any]:
        """Wait until a job is in one of some states."""
        deadline = time.monotonic() + seconds
        while (job := self.job(job_id))["state"] not in states:
            if time.monotonic() > deadline:
                pytest.fail(f"{job_id} is {job['state']} after {seconds} s, not {states}.")
            time.sleep(0.1)
        return job


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
