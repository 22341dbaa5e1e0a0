"""Waiting for what has to come, on a machine whose cores may all have other work."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE = 600.0
"""What a wait gives up after [s]: so long that only what never comes is given up."""


def until(condition: Callable[[], object], what: str = "It does not happen.") -> None:
    """Wait until something is true.

    Raises:
        AssertionError: It is not, with these words.
    """
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)
