"""Whether the clock of this machine can be believed when jobs are deleted for their age."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

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
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._wall, self._passed = self._remembered(), time.monotonic()
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
