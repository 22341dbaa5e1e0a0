"""A service of our own to measure, and the jobs that it is given."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import psutil

from chamfer_morph.schemas import Scope
from chamfer_morph.server.database.api_keys import ApiKeyStore
from chamfer_morph.server.database.tables import create
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.settings import Settings

START_SECONDS = 300.0
STOP_SECONDS = 20.0
PATIENCE_SECONDS = 1800.0


@dataclass(frozen=True)
class LocalService:
    """A service with its folder and database.

    Attributes:
        data_dir: A folder of its own.
        database_url: An empty Postgres database; empty for SQLite in the folder.
        pooler_url: The same database behind a pooler of connections; empty without.
    """

    data_dir: Path
    database_url: str
    pooler_url: str = ""

    @property
    def settings(self) -> Settings:
        """The service's settings, for looking at its queue and its files."""
        return Settings(
            _env_file=None, data_dir=self.data_dir, database_url=self.database_url, threads=1
        )

    def add_key(self, name: str, *scopes: Scope) -> dict[str, str]:
        """Make a key before the service is started; returns the header that shows it."""
        engine = database(self.settings)
        create(engine)
        made = ApiKeyStore(engine).add(name, scopes)
        engine.dispose()
        assert made is not None, "the database is not empty"
        return {"Authorization": f"Bearer {made[1]}"}

    @contextmanager
    def served(
        self, workers: int, threads: int = 1, **settings: object
    ) -> Iterator[tuple[httpx.Client, psutil.Process]]:
        """Run `morph serve` with default settings but for the threads, and for those given.

        Args:
            workers: Worker slots.
            threads: Of a job; 0 shares the cores out evenly.
            settings: Others, by their names in `Settings`.

        Yields:
            A client of the API, and the supervisor.
        """
        port = free_port()
        own = {name: value for name, value in os.environ.items() if not name.startswith("MORPH_")}
        given = {f"MORPH_{name.upper()}": str(value) for name, value in settings.items()}
        with (self.data_dir / "service.log").open("ab") as log:
            supervisor = psutil.Popen(
                [sys.executable, "-m", "chamfer_morph.server", "serve"],
                env=own
                | {
                    "MORPH_DATA_DIR": str(self.data_dir),
                    "MORPH_DATABASE_URL": self.database_url,
                    "MORPH_DATABASE_POOLER_URL": self.pooler_url,
                    "MORPH_PORT": str(port),
                    "MORPH_WORKERS": str(workers),
                    "MORPH_THREADS": str(threads),
                }
                | given,
                stdout=log,
                stderr=log,
            )
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=30) as api:
                wait_until_ready(api)
                yield api, supervisor
        finally:
            if supervisor.is_running():
                supervisor.send_signal(signal.SIGTERM)
            try:
                supervisor.wait(STOP_SECONDS)
            except subprocess.TimeoutExpired:
                supervisor.kill()


def processes(supervisor: psutil.Process, *words: str) -> list[psutil.Process]:
    """Processes of a service whose command has these words."""
    found = []
    for process in supervisor.children(recursive=True):
        with suppress(psutil.Error):  # it has ended
            if set(words) <= set(process.cmdline()):
                found.append(process)
    return found


def peak_memory(process: psutil.Process) -> int:
    """Largest resident memory of a process so far, as Linux keeps it [bytes]."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
    return int(status.partition("VmHWM:")[2].split()[0]) << 10


def forget_peak_memory(process: psutil.Process) -> None:
    """Let `peak_memory` begin with what a process has now."""
    Path(f"/proc/{process.pid}/clear_refs").write_text("5", encoding="ascii")


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(condition: Callable[[], object], what: str) -> None:
    """Wait for what a service does by itself.

    Raises:
        TimeoutError: It does not; these are the words.
    """
    deadline = time.monotonic() + PATIENCE_SECONDS
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(what)
        time.sleep(0.1)


def wait_until_ready(api: httpx.Client) -> None:
    """Wait until the service can take jobs."""
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            if api.get("/readyz").is_success:
                return
        except httpx.TransportError:
            pass
        if time.monotonic() > deadline:
            raise TimeoutError("The service does not become ready.")
        time.sleep(0.1)


def job_request(frames: int, points_per_cell_edge: int = 1) -> dict[str, Any]:
    """A request for a job on the CPU; 1 point per cell edge makes the smallest."""
    return {
        "method": "joint",
        "source": {"shape": "sphere"},
        "target": {"shape": "star"},
        "overrides": {"sampling.points_per_cell_edge": points_per_cell_edge},
        "frames": frames,
        "device": "cpu",
    }


def submit(api: httpx.Client, request: dict[str, Any]) -> str:
    """Submit a job; returns its id."""
    answer = api.post("/v1/jobs", json=request)
    answer.raise_for_status()
    return str(answer.json()["id"])


def job_document(api: httpx.Client, job: str) -> dict[str, Any]:
    """A job as it stands."""
    answer = api.get(f"/v1/jobs/{job}")
    answer.raise_for_status()
    shown: dict[str, Any] = answer.json()
    return shown
