"""A spare engine process, so that a job begins with its data and not with imports and kernels."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from chamfer_morph.worker.engines.engine import Engine
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from morph_engine.machine_cores import usable_cores

NEARLY_DONE = 0.9
"""Share of a job's frames after which the process for the next job is started, if one waits."""

ASK_SECONDS = 1.0
"""How often it is asked whether one does."""

PAUSE_SECONDS = 10.0
"""After a spare process that has died, until the next one."""

log: logging.Logger = logging.getLogger(__name__)


class SpareEngine:
    """An engine process that is ready for the next job of a slot.

    Each computes one job at most. The next is started once that job has ended, or is nearly done
    where another one waits, so that it takes little from what somebody waits for. Of that job it
    learns the method and the extent of the grid, and nothing else: kernels are compiled for each.

    Args:
        settings: Threads, and whether to keep a spare process at all.
        storage: The files of the service.
        jobs_wait: Whether there are jobs in the queue that nobody has begun.
    """

    def __init__(
        self,
        settings: Settings,
        storage: Storage,
        jobs_wait: Callable[[], bool] = lambda: True,
    ) -> None:
        self._kept = settings.warm_engines
        self._jobs_wait = jobs_wait
        self._new_engine = partial(
            Engine, threads_per_job(settings), storage, log_format=settings.log_format
        )
        self._lock = threading.Lock()  # one thread keeps it, another takes it
        self._spare: Engine | None = None
        self._taken: Engine | None = None  # the last one that was
        self._method: str | None = None  # of its job
        self._enough_frames = 0.0  # for which it has been taken
        self._start_at = 0.0
        self._ask_at = 0.0

    def keep(self) -> None:
        """Start a process if there is none and it is time; to be called several times a second."""
        if not self._kept:
            return
        with self._lock:
            if self._spare and self._spare.ended:
                log.warning("A spare engine process has ended; another one will be started.")
                self._spare, self._start_at = None, time.monotonic() + PAUSE_SECONDS
            if not self._spare and time.monotonic() >= self._start_at and self._is_time():
                extent = self._taken.extent if self._taken else None
                self._spare = self._new_engine(method=self._method, extent=extent)

    def take(self, spec: JobSpec, job_dir: Path) -> Engine:
        """A process for a job: the spare one, ready or not, if it suits the job, or a new one."""
        with self._lock:
            self._method = spec.config.method.name
            self._enough_frames = NEARLY_DONE * spec.frame_count
            if self._spare and self._spare.suits(spec):
                self._taken, self._spare = self._spare, None
            else:
                with (job_dir / "log.txt").open("ab") as messages:
                    self._taken = self._new_engine(job_dir=job_dir, log=messages)
            return self._taken

    def end(self) -> None:
        """End the spare process at once, which it does by itself soon after this one ends."""
        with self._lock:
            if self._spare:
                self._spare.kill()

    def _is_time(self) -> bool:
        """Whether the last process has ended, or is nearly done and a job waits."""
        if not self._taken or self._taken.ended:
            return True
        if self._taken.frames < self._enough_frames or time.monotonic() < self._ask_at:
            return False
        self._ask_at = time.monotonic() + ASK_SECONDS
        return self._jobs_wait()


def threads_per_job(settings: Settings) -> int:
    """CPU threads of a job: as set, or an even share of the cores there are."""
    return settings.threads or max(1, usable_cores() // max(1, settings.workers))
