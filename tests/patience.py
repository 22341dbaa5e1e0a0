"""Waiting for what has to come, on a machine whose cores may all have other work."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Page

    Opened = TypeVar("Opened", Page, BrowserContext)

PATIENCE = 600.0
"""What a wait gives up after [s]: so long that only what never comes is given up."""

PAGE_PATIENCE = 180_000
"""How long a page in a browser may take for anything [ms]; a first job compiles its kernels."""


def patient(opened: Opened) -> Opened:
    """A page or a browser's context that waits as long as that."""
    opened.set_default_timeout(PAGE_PATIENCE)
    return opened


def until(condition: Callable[[], object], what: str = "It does not happen.") -> None:
    """Wait until something is true.

    Raises:
        AssertionError: It is not, with these words.
    """
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)
