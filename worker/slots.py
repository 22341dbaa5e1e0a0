"""Worker slots: their names, and pausing them."""

from __future__ import annotations

import re
import socket
from pathlib import Path


def executor_id(slot: int) -> str:
    """Name of a slot of this machine."""
    return f"{re.sub(r'[^A-Za-z0-9.-]', '-', socket.gethostname())}-slot{slot}"


def is_paused(data_dir: Path, executor: str) -> bool:
    """Whether a slot takes no new jobs."""
    return _pause_file(data_dir, executor).exists()


def pause(data_dir: Path, executor: str) -> None:
    """Let a slot finish its job and take no other, until `unpause`."""
    _pause_file(data_dir, executor).touch()


def unpause(data_dir: Path, executor: str) -> None:
    """Let a slot take jobs again."""
    _pause_file(data_dir, executor).unlink(missing_ok=True)


def names(data_dir: Path) -> list[str]:
    """Names of all slots that have ever run on this storage."""
    return sorted(path.name for path in (data_dir / "workers").glob("*-slot*[0-9]"))


def register(data_dir: Path, executor: str) -> None:
    """Note that a slot runs on this storage."""
    (data_dir / "workers" / executor).touch()


def _pause_file(data_dir: Path, executor: str) -> Path:
    if not re.fullmatch(r"[A-Za-z0-9.-]+", executor):
        raise ValueError(f"{executor!r} is no worker slot")
    return data_dir / "workers" / f"{executor}.paused"
