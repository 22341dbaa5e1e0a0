"""A running API on a real database and a real socket, without workers."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
import pytest

from chamfer_morph.server.api_server import ApiServer
from chamfer_morph.server.context import ServerContext
from chamfer_morph.server.listener import address, listen
from chamfer_morph.worker.settings import Settings
from morph_engine import configure
from morph_engine.morphing import prepare
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import write_result
from tests.integration.api.contract import check_documented
from tests.patience import PATIENCE, until

CUBE = """v 0 0 0\nv 10 0 0\nv 10 10 0\nv 0 10 0\nv 0 0 10\nv 10 0 10\nv 10 10 10\nv 0 10 10
f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7
f 4 1 5\nf 4 5 8
"""
MORPH = {"source": {"shape": "sphere"}, "target": {"shape": "star"}, "frames": 3}
COARSE = {"sampling.points_per_cell_edge": 2}


@dataclass
class Api:
    """A running API.

    Attributes:
        http: A client of it.
        context: What its endpoints share.
        settings: Its settings.
    """

    http: httpx.Client
    context: ServerContext
    settings: Settings

    def submit(self, **changes: Any) -> dict[str, Any]:
        """Submit a small morph."""
        answer = self.http.post("/v1/jobs", json=MORPH | changes)
        assert answer.status_code == 202, answer.text
        job: dict[str, Any] = answer.json()
        return job

    def running(self, run: RunRecord) -> str:
        """A job with two frames: the source moved by 1 and by 3 grid units along x."""
        job: str = self.submit(overrides=COARSE)["id"]
        result = self.context.storage.result_path(job)
        result.parent.mkdir()
        with Spool.create(result, run) as spool:
            for index, moved in enumerate((1, 3)):
                spool.append(index, run.source_points + np.float32([moved, 0, 0]), {"s2t": moved})
            spool.save_checkpoint(1, {"x": spool.positions(1)}, {})
        return job

    def finished(self, run: RunRecord) -> str:
        """The same, cancelled after its second frame."""
        job = self.running(run)
        assert self.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
        with Spool.open(self.context.storage.result_path(job), writable=False) as spool:
            write_result(spool, status="partial")
        return job

    def uploads(self) -> list[Path]:
        """Files of uploads that are still lying about."""
        return [path for path in self.context.storage.uploads.iterdir() if path.name[0] != "."]


@pytest.fixture(scope="session")
def run() -> RunRecord:
    """Sphere to star with few particles."""
    return prepare("sphere", "star", configure("fast", COARSE | {"frames": 3}))


@contextmanager
def serving(settings: Settings) -> Iterator[Api]:
    """Answer requests in a thread of this process."""
    listener = listen(settings)
    server = ApiServer(settings)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        while not server.started:
            assert thread.is_alive(), "the API did not start"
            time.sleep(0.01)
        hooks = {"response": [check_documented]}
        with httpx.Client(
            base_url=address(settings, listener), timeout=PATIENCE, event_hooks=hooks
        ) as http:
            yield Api(http, server.context, settings)
    finally:
        server.should_exit = True
        thread.join(PATIENCE)
        listener.close()


@pytest.fixture
def make_api(tmp_path: Path) -> Iterator[Callable[..., Api]]:
    """Starts an API with the given settings, on SQLite unless they name a database."""
    with ExitStack() as stack:

        def make(**settings: Any) -> Api:
            folder = tmp_path / f"data-{uuid.uuid4().hex[:6]}"
            values = {"data_dir": folder, "port": 0, "host": "127.0.0.1"} | settings
            return stack.enter_context(serving(Settings(_env_file=None, **values)))

        yield make


@pytest.fixture
def api(make_api: Callable[..., Api]) -> Api:
    """An API on SQLite with the usual settings."""
    return make_api()


@pytest.fixture
def either(make_api: Callable[..., Api], database_url: str) -> Api:
    """An API on SQLite, and one on Postgres."""
    return make_api(database_url=database_url)


@dataclass
class ApiProcess:
    """An API in a process of its own.

    Attributes:
        http: A client of it.
        process: The process.
    """

    http: httpx.Client
    process: psutil.Process

    def children(self) -> list[psutil.Process]:
        """What it has computed at the moment in processes of their own."""
        return self.process.children(recursive=True)


@pytest.fixture
def start_apis() -> Iterator[Callable[..., list[ApiProcess]]]:
    """Starts some API processes on one data directory and database."""
    with ExitStack() as stack:

        def start(settings: Settings, count: int = 2) -> list[ApiProcess]:
            own = {name: value for name, value in os.environ.items() if name[:6] != "MORPH_"}
            values = settings.model_dump(mode="json", exclude_defaults=True).items()
            variables = {f"MORPH_{name.upper()}": str(value) for name, value in values}
            return [
                stack.enter_context(api_process(settings, own | variables)) for _ in range(count)
            ]

        yield start


@contextmanager
def api_process(settings: Settings, environment: dict[str, str]) -> Iterator[ApiProcess]:
    """An API in a process of its own, until the end of the context."""
    with listen(settings) as listener:
        descriptor = listener.fileno()
        command = [sys.executable, "-m", "chamfer_morph.server", "api", "--fd", str(descriptor)]
        with subprocess.Popen(command, env=environment, pass_fds=[descriptor]) as process:
            limits = httpx.Limits(max_connections=None)
            with httpx.Client(
                base_url=address(settings, listener), timeout=PATIENCE, limits=limits
            ) as http:
                assert http.get("/readyz").status_code == 200
                yield ApiProcess(http, psutil.Process(process.pid))
            process.terminate()


def halted_child(task: str) -> psutil.Process:
    """The child of this process that computes a task, once there is one; it is halted."""
    halted = []

    def halt() -> bool:
        for child in psutil.Process().children():
            with suppress(psutil.Error):  # it has ended
                if f"chamfer_morph.worker.tasks.{task}" in child.cmdline():
                    child.suspend()
                    halted.append(child)
                    return True
        return False

    until(halt, f"nothing computes {task}")
    return halted[0]


@pytest.fixture
def cube() -> bytes:
    """A mesh file: a cube of 1000 cubic grid units."""
    return CUBE.encode()
