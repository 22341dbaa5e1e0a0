"""What a process of the service keeps from other users of its machine."""

from __future__ import annotations

import os


def keep_private() -> None:
    """Let files that this process and its children make be for its user alone."""
    os.umask(0o077)
