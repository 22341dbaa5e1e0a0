"""Exit statuses by which child processes say why they ended."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """An end that is neither success nor a crash."""

    REFUSED = 2
    """It cannot start as it was called or set up, and another start would not help."""

    ORPHANED = 75
    """Its parent has died or fallen silent."""

    STOPPED = 76
    """Its parent has told it to stop."""

    OUT_OF_MEMORY = 77
    """It has reached its limit of memory."""

    PAUSED = 78
    """Its worker slot has been paused or unpaused, and begins afresh."""

    DATABASE_REFUSES = 79
    """The database cannot be used, say for a full disk, and nothing can be reported."""
