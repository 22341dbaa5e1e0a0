"""One attempt at a job, as its worker sees it: take an engine, follow it, explain its end."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from chamfer_morph.schemas import Outcome, Problem
from chamfer_morph.worker.engines.engine import Engine
from chamfer_morph.worker.engines.spare_engine import SpareEngine
from chamfer_morph.worker.job import LESS_MEMORY, JobSpec
from chamfer_morph.worker.service_log import last_words
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import folder_bytes
from chamfer_morph.worker.telemetry import EngineSpans, is_on
from morph_engine.results.spool import spool_path

HEARTBEAT_SECONDS = 1.0
STOP_SECONDS = 1.5
LOG_TAIL_BYTES = 2000
PROGRAM = Path(__file__).resolve().parents[1]
"""Where this program lies."""

DISK_SECONDS = 10.0
"""How often it is seen how much disk a job fills."""


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


async def run_attempt(
    job_dir: Path,
    attempt: int,
    settings: Settings,
    spare: SpareEngine,
    heartbeat: Callable[[], Awaitable[None]],
) -> Outcome:
    """Run an engine on a job directory until it is done.

    Args:
        job_dir: The job's directory, with spec.json.
        attempt: Number of the attempt, from 1.
        settings: Patience.
        spare: Where engines come from.
        heartbeat: Called every second; what it raises ends the attempt (the job was cancelled, or
            belongs to another worker by now).

    Returns:
        What the job left behind.

    Raises:
        AttemptFailed: The engine refused the job, died, hung, or took more memory or disk than jobs
            may.
    """
    spec = JobSpec.model_validate_json((job_dir / "spec.json").read_text(encoding="utf-8"))
    largest = settings.memory_per_job
    engine = spare.take(spec, job_dir)
    spans = EngineSpans(spec.frame_count) if is_on() else None
    engine.assign(job_dir, attempt, largest, spans)
    ended = asyncio.ensure_future(asyncio.to_thread(engine.wait))
    next_look = time.monotonic()
    try:
        while not ended.done():
            await asyncio.wait({ended}, timeout=HEARTBEAT_SECONDS)
            await heartbeat()
            engine.beat()
            if engine.peak_memory > largest:
                engine.kill()
                raise AttemptFailed(_too_large(engine, largest), engine.frames)
            if time.monotonic() >= next_look:
                next_look = time.monotonic() + DISK_SECONDS
                filled = await asyncio.to_thread(_unfinished_bytes, job_dir)
                if filled > settings.disk_bytes_per_key:
                    raise AttemptFailed(_too_much_disk(filled, settings), engine.frames)
            if time.monotonic() - engine.last_message_at > settings.stall_seconds:
                raise AttemptFailed(_hang(settings), engine.frames)
    except BaseException:
        await _stop(engine, ended)
        raise
    if engine.outcome is not None:
        return engine.outcome
    problem = engine.problem or _crash(ended.result(), engine, job_dir / "log.txt")
    raise AttemptFailed(_without_folders(problem, job_dir.parent.parent), engine.frames)


async def _stop(engine: Engine, ended: asyncio.Future[int]) -> None:
    """Ask an engine to keep its frames and end; kill it if it takes long.

    DBOS may cancel the task that waits here, too; the engine gets its time all the same.
    """
    engine.stop()
    deadline = time.monotonic() + STOP_SECONDS
    while not ended.done() and time.monotonic() < deadline:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.wait({ended}, timeout=deadline - time.monotonic())
    if not ended.done():
        engine.kill()


def _without_folders(problem: Problem, data_dir: Path) -> Problem:
    """The same for users, who need not know where data directory and programs lie."""
    folders = {data_dir, Path(sys.prefix), Path(sys.base_prefix), PROGRAM, Path.home()}
    told = {"cause": problem.cause, "remedy": problem.remedy}
    for folder in sorted(map(str, folders), key=len, reverse=True):  # the inner ones first
        told = {name: text.replace(f"{folder}/", "") for name, text in told.items()}
    return problem.model_copy(update=told)


def _hang(settings: Settings) -> Problem:
    return Problem(
        cause=f"The engine finished no frame for {settings.stall_seconds:g} s and was stopped.",
        remedy="Try fewer points per cell edge, or raise MORPH_STALL_SECONDS.",
        kind="hang",
    )


def _too_large(engine: Engine, largest: int) -> Problem:
    return Problem(
        cause=f"The engine used {engine.peak_memory / 1e6:,.0f} MB of memory, more than the "
        f"limit of {largest / 1e6:,.0f} MB per job, and was stopped.",
        remedy=LESS_MEMORY,
        kind="resources",
    )


def _unfinished_bytes(job_dir: Path) -> int:
    """Disk that frames and states of a job fill; the result takes the place of frames [bytes]."""
    return folder_bytes(spool_path(job_dir / "result.vtkhdf")) + folder_bytes(job_dir / "states")


def _too_much_disk(filled: int, settings: Settings) -> Problem:
    return Problem(
        cause=f"The job's frames and states take {filled / 1e9:,.1f} GB of disk, and with them "
        f"its key exceeds its quota of {settings.disk_bytes_per_key / 1e9:,.1f} GB.",
        remedy="Request fewer `frames`, states (`states_every`) or particles, or raise "
        "MORPH_DISK_BYTES_PER_KEY and resume the job.",
        kind="resources",
    )


def _crash(status: int, engine: Engine, log: Path) -> Problem:
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
        cause=f"{how} Its last output: {last}" if last else how,
        remedy="Read the job's log; if it fails again, report it with the log.",
        kind="crash",
    )


def _last_line(log: Path) -> str:
    """The last line of a log that says something; nothing where there is no log."""
    try:
        with log.open("rb") as file:
            file.seek(max(file.seek(0, os.SEEK_END) - LOG_TAIL_BYTES, 0))
            lines = file.read().decode(errors="replace").split("\n")
    except FileNotFoundError:
        return ""
    return last_words(next((line.strip() for line in reversed(lines) if line.strip()), ""))
