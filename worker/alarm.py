"""What makes a worker look for a job at once: a notification, or the end of the job before.

Without either it looks from time to time, as `Settings.queue_poll_seconds` says.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

CHANNEL = "morph_jobs"
"""Where Postgres is told of jobs that may start."""

LOOK_SECONDS = 0.1
"""How often to see whether the job has ended; this asks nobody but the process itself."""

SETTLING_SECONDS, SETTLING_PAUSE_SECONDS = 5.0, 0.25
"""For so long after the start it looks often: jobs that the slot has left are just being queued."""


class Alarm(threading.Event):
    """In place of the event whose timeouts are the pauses between two looks into the queue.

    Args:
        is_busy: Whether this process has a job.
    """

    def __init__(self, is_busy: Callable[[], bool]) -> None:
        super().__init__()
        self._is_busy = is_busy
        self._rung = threading.Event()
        self._settled_at = time.monotonic() + SETTLING_SECONDS

    def ring(self) -> None:
        """There may be a job."""
        self._rung.set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it rings, or the job ends, or for so long [s]; True to stop."""
        begin, was_busy = time.monotonic(), False
        pause = float("inf") if timeout is None else timeout
        if begin < self._settled_at:
            pause = min(pause, SETTLING_PAUSE_SECONDS)
        deadline = begin + pause
        while (left := deadline - time.monotonic()) > 0 and not self.is_set():
            if self._rung.wait(min(left, LOOK_SECONDS)):
                break
            busy = self._is_busy()
            if was_busy and not busy:
                break
            was_busy = busy
        self._rung.clear()
        return self.is_set()
