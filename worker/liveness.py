"""Whether a process gets on: it touches a file from time to time, and a probe looks at the file."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

from chamfer_morph.worker.settings import Settings

LIMIT_SECONDS = 300.0
"""A process that has not got on for so long hangs; the janitor may delete jobs for minutes."""


def get_on(settings: Settings, name: str) -> None:
    """Note that the process of this name gets on."""
    with suppress(OSError):  # the disk refuses, as what the process does next will tell
        _file(settings, name).touch()


def gets_on(settings: Settings, name: str) -> bool:
    """Whether the process of this name has got on lately."""
    try:
        age = time.time() - _file(settings, name).stat().st_mtime
    except OSError:
        return False
    return age < LIMIT_SECONDS + settings.adoption_seconds


def _file(settings: Settings, name: str) -> Path:
    return settings.data_dir / "locks" / f"{name}.alive"
