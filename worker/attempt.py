"""One attempt at a job, as its worker sees it: start the engine, follow it, explain its end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from chamfer_morph.schemas import Outcome, Problem
from chamfer_morph.worker.heartbeat import HEARTBEAT, STOP
from chamfer_morph.worker.settings import Settings
from morph_engine.child_process import python_command

HEARTBEAT_SECONDS = 1.0
STOP_SECONDS = 1.5
LOG_TAIL_BYTES = 2000


class AttemptFailed(Exception):
    """An attempt has failed.

    Attributes:
        problem: Why.
        frames: Frames it finished itself.
    """

    def __init__(self, problem: Problem, frames: int) -> None:
        super().__init__(problem.cause)
        self.problem = problem
        self.frames = frames

    @property
    def worth_another(self) -> bool:
        """Whether the same attempt might succeed: the engine died, rather than refused."""
        return self.problem.kind in ("crash", "hang")


@dataclass
class _EngineState:
    """What is known of an engine process."""

    outcome: Outcome | None = None
    problem: Problem | None = None
    frames: int = 0
    last_message_at: float = field(default_factory=time.monotonic)
    peak_memory: int = 0


async def run_attempt(
    job_dir: Path, attempt: int, settings: Settings, heartbeat: Callable[[], Awaitable[None]]
) -> Outcome:
    """Run the engine on a job directory until it is done.

    Args:
        job_dir: The job's directory, with spec.json.
        attempt: Number of the attempt, from 1.
        settings: Threads and patience.
        heartbeat: Called every second; what it raises ends the attempt (the job was cancelled, or
            belongs to another worker by now).

    Returns:
        What the job left behind.

    Raises:
        AttemptFailed: The engine refused the job, died or hung.
    """
    with (job_dir / "log.txt").open("ab") as log:
        process = await asyncio.create_subprocess_exec(
            *python_command(
                "chamfer_morph.worker.engine_process",
                str(job_dir), str(attempt), str(threads_per_job(settings)),
            ),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=log,
            start_new_session=True,
        )  # fmt: skip
    engine = _EngineState()
    reader = asyncio.create_task(_read_messages(process, engine))
    try:
        while not reader.done():
            await asyncio.wait({reader}, timeout=HEARTBEAT_SECONDS)
            await heartbeat()
            _send(process, HEARTBEAT)
            engine.peak_memory = max(engine.peak_memory, _memory(process.pid))
            if time.monotonic() - engine.last_message_at > settings.stall_seconds:
                raise AttemptFailed(_hang(settings), engine.frames)
        status = await process.wait()
    except BaseException:
        await _stop(process, reader)
        raise
    if engine.outcome is not None:
        return engine.outcome
    raise AttemptFailed(
        engine.problem or _crash(status, engine, job_dir / "log.txt"), engine.frames
    )


def threads_per_job(settings: Settings) -> int:
    """CPU threads of a job: as set, or an even share of the cores."""
    return settings.threads or max(1, (os.cpu_count() or 1) // max(1, settings.workers))


async def _read_messages(process: asyncio.subprocess.Process, engine: _EngineState) -> None:
    """Read what the engine process says until it ends."""
    assert process.stdout is not None
    async for line in process.stdout:
        with contextlib.suppress(ValueError):  # anything else that was printed
            message: dict[str, Any] = json.loads(line)
            engine.last_message_at = time.monotonic()
            match message["type"]:
                case "frame":
                    engine.frames += 1
                case "done":
                    engine.outcome = Outcome.model_validate(message["data"])
                case "failed":
                    engine.problem = Problem.model_validate(message["data"])


async def _stop(process: asyncio.subprocess.Process, reader: asyncio.Task[None]) -> None:
    """Ask the engine process to keep its frames and end; kill it if it takes long.

    DBOS may cancel the task that waits here, too; the engine gets its time all the same.
    """
    _send(process, STOP)
    ended = asyncio.ensure_future(process.wait())
    deadline = time.monotonic() + STOP_SECONDS
    while not ended.done() and time.monotonic() < deadline:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.wait({ended}, timeout=deadline - time.monotonic())
    if not ended.done():
        with contextlib.suppress(ProcessLookupError):
            process.kill()
    reader.cancel()


def _send(process: asyncio.subprocess.Process, message: bytes) -> None:
    with contextlib.suppress(OSError, RuntimeError):  # it ended just now
        assert process.stdin is not None
        process.stdin.write(message)


def _memory(pid: int) -> int:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0


def _hang(settings: Settings) -> Problem:
    return Problem(
        cause=f"The engine finished no frame for {settings.stall_seconds:g} s and was stopped.",
        remedy="Try fewer points per cell edge, or raise MORPH_STALL_SECONDS.",
        kind="hang",
    )


def _crash(status: int, engine: _EngineState, log: Path) -> Problem:
    """Say of an engine process that ended without a word how it ended."""
    megabytes = engine.peak_memory / 1e6
    if status == -signal.SIGKILL:
        return Problem(
            cause=f"The engine was killed (signal 9) while it used {megabytes:,.0f} MB of memory.",
            remedy="If the machine ran out of memory, lower the points per cell edge or run fewer "
            "jobs at a time.",
            kind="crash",
        )
    if status < 0:
        name = signal.Signals(-status).name
        how = f"The engine crashed ({name}, signal {-status}) using {megabytes:,.0f} MB of memory."
    else:
        how = f"The engine ended with exit status {status}."
    last = _last_line(log)
    return Problem(
        cause=f"{how} Its last words: {last}" if last else how,
        remedy="Read the job's log; if it fails again, report it with the log.",
        kind="crash",
    )


def _last_line(log: Path) -> str:
    """The last line of a log that says something."""
    with log.open("rb") as file:
        file.seek(max(file.seek(0, os.SEEK_END) - LOG_TAIL_BYTES, 0))
        lines = file.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "")
