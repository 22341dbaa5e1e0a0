"""Whether the clock of this machine can be believed when jobs are deleted for their age."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from chamfer_morph.worker.retention.job_sizes import JobSizes
from chamfer_morph.worker.settings import Settings

JUMP_SECONDS = 600.0
"""Difference from the time that has passed which counts as a jump."""

ABSENCE_SECONDS = 86400.0
"""After so long without anybody looking, the clock may as well have jumped."""

TRUST_SECONDS = 86400.0
"""How long it has to run evenly after a jump: time to notice a wrong clock and set it right."""


class SteadyClock:
    """Watches the wall clock, across restarts by a file.

    Args:
        path: The file.
        last_known: A time that has been, for a machine without the file [s since 1970].
    """

    def __init__(self, path: Path, last_known: Callable[[], float | None] = lambda: None) -> None:
        self._path = path
        self._wall, self._passed = self._remembered() or last_known(), time.monotonic()
        self._first_look = True
        self._doubted_until = 0.0

    def is_steady(self) -> bool:
        """Look at the clock; False for a day after it has jumped."""
        wall, passed = time.time(), time.monotonic()
        elapsed = passed - self._passed
        if self._first_look:
            jumped = not -JUMP_SECONDS <= wall - (self._wall or wall) <= ABSENCE_SECONDS
        else:
            jumped = abs(wall - (self._wall or wall) - elapsed) > JUMP_SECONDS
        if jumped:
            self._doubted_until = passed + TRUST_SECONDS
        self._wall, self._passed, self._first_look = wall, passed, False
        steady = passed >= self._doubted_until
        if steady:
            with suppress(OSError):
                self._path.write_text(f"{wall:.0f}\n", encoding="ascii")
        return steady

    def _remembered(self) -> float | None:
        try:
            return float(self._path.read_text(encoding="ascii"))
        except (OSError, ValueError):
            return None


def clock_of(settings: Settings, sizes: JobSizes) -> SteadyClock:
    """The clock of this machine, which knows without its file when the last job has finished."""
    return SteadyClock(settings.data_dir / "locks" / "clock", sizes.newest)
