"""An engine process as its worker sees it: started, given a job, followed until its end."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import threading
import time
from pathlib import Path
from typing import IO, Any

import psutil

from chamfer_morph.schemas import Outcome, Problem
from chamfer_morph.worker import service_log
from chamfer_morph.worker.heartbeat import HEARTBEAT, STOP
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.sandbox.landlock import list_of_fonts, user_cache
from chamfer_morph.worker.storage import Storage
from chamfer_morph.worker.telemetry import EngineSpans
from morph_engine.child_process import environment_without_secrets, python_command


class Engine:
    """A process that gets ready, and then computes the one job that it is given.

    Args:
        threads: CPU threads that it computes with.
        storage: The files of the service.
        log_format: How it logs, `text` or `json`.
        job_dir: The directory of its job, where that is known; it sees no other then.
        method: Method that its job will probably have.
        extent: Half the cells along an axis of the grid that its job will probably have.
        log: Where it writes messages before it has a job; those of this process if not given.

    Attributes:
        pid: Its process id.
        outcome: What its job has left, once it is done.
        problem: Why it has refused its job, if so.
        extent: Half the cells along an axis of its job's grid, once it has said so.
        frames: Frames that it has finished.
        last_message_at: When it said something last, a time of `time.monotonic`.
        peak_memory: The most memory that it was seen to use [bytes].
    """

    def __init__(
        self,
        threads: int,
        storage: Storage,
        *,
        log_format: str = "text",
        job_dir: Path | None = None,
        method: str | None = None,
        extent: int | None = None,
        log: IO[bytes] | None = None,
    ) -> None:
        self.outcome: Outcome | None = None
        self.problem: Problem | None = None
        self.extent: int | None = None
        self.frames: int = 0
        self.last_message_at: float = time.monotonic()
        self.peak_memory: int = 0
        self._device: str | None = None  # that it has started Taichi on, once it is ready
        self._spans: EngineSpans | None = None
        likely = json.dumps({"method": method, "extent": extent})
        engine = (str(threads), str(storage.kept_results), likely, log_format)
        self._process = subprocess.Popen(
            python_command(
                "chamfer_morph.worker.sandbox.offline",
                files_of_engine(storage, job_dir),
                "chamfer_morph.worker.engine_process",
                *engine,
            ),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
            bufsize=0, start_new_session=True, env=environment_without_secrets(),
        )  # fmt: skip
        self.pid: int = self._process.pid
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        self._reader = threading.Thread(target=self._read_messages, daemon=True)
        self._reader.start()

    @property
    def ended(self) -> bool:
        """Whether the process is gone."""
        return self._process.poll() is not None

    def suits(self, spec: JobSpec) -> bool:
        """Whether it lives, and is not ready for something other than what a job needs.

        While it gets ready it suits a job for any device: it skips the rest, and begins.
        """
        fits_device = self._device is None or spec.device in ("auto", self._device)
        return spec.config.precision == "float32" and fits_device and not self.ended

    def assign(
        self, job_dir: Path, attempt: int, memory_bytes: int, spans: EngineSpans | None = None
    ) -> None:
        """Let it compute a job.

        Args:
            job_dir: The job's directory.
            attempt: Number of the attempt, from 1.
            memory_bytes: Memory that it may take [bytes].
            spans: Who is told of its spans, if anybody.
        """
        self.last_message_at = time.monotonic()
        self._spans = spans
        job = {
            "job_dir": str(job_dir),
            "attempt": attempt,
            "memory_bytes": memory_bytes,
            "traced": spans is not None,
            "request": service_log.request_id.get(),
        }
        self._send(json.dumps(job).encode() + b"\n")

    def beat(self) -> None:
        """Tell it that its worker lives, and look how much memory it uses."""
        self._send(HEARTBEAT)
        with contextlib.suppress(psutil.Error):
            memory = int(psutil.Process(self.pid).memory_info().rss)
            self.peak_memory = max(self.peak_memory, memory)

    def stop(self) -> None:
        """Ask it to keep its frames and end."""
        self._send(STOP)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def wait(self) -> int:
        """Wait for its end; returns its exit status, negative for a signal."""
        assert self._process.stdin is not None
        self._reader.join()
        self._process.stdin.close()
        return self._process.wait()

    def _send(self, message: bytes) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # it ended just now
            self._process.stdin.write(message)

    def _read_messages(self) -> None:
        """Read what it says until it ends."""
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            buffer = b""
            while read := lines.read(1 << 16):
                *whole, buffer = (buffer + read).split(b"\n")
                for line in whole:
                    with contextlib.suppress(ValueError):  # anything else that was printed
                        self._receive(json.loads(line))
        if self._spans:
            self._spans.close()

    def _receive(self, message: dict[str, Any]) -> None:
        if self._spans and message["type"] == "span_begins":
            return self._spans.begin(**message["data"])
        if self._spans and message["type"] == "span_ends":
            return self._spans.end(**message["data"])
        self.last_message_at = time.monotonic()
        match message["type"]:
            case "ready":
                self._device = message["data"]["device"]
            case "started":
                self.extent = message["data"]["extent"]
            case "frame":
                self.frames += 1
            case "done":
                self.outcome = Outcome.model_validate(message["data"])
            case "failed":
                self.problem = Problem.model_validate(message["data"])


def files_of_engine(storage: Storage, job_dir: Path | None = None) -> str:
    """What an engine process needs of the files, beside those of the program, for `offline`.

    Args:
        storage: The files of the service.
        job_dir: The directory of its job; those of all jobs if that is not known yet.
    """
    kernels = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or user_cache() / "taichi"
    writes = (job_dir or storage.root / "jobs", storage.kept_results, kernels, list_of_fonts())
    return json.dumps({"reads": [f"{storage.root / 'meshes'}"], "writes": [*map(str, writes)]})
