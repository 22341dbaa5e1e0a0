"""The service answers while its machine computes: what computes yields to all others."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

NICENESS = 10


def yield_to_others() -> None:
    """Let all others have the cores first.

    Where Linux groups processes by session it heeds the niceness of a group; ours is this process.
    """
    os.nice(NICENESS)
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(NICENESS), encoding="ascii")
