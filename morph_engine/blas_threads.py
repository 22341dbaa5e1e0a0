"""Small matrices on one thread: others would only wait, and their number would change the sums."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import lazy_loader as lazy

threadpoolctl: Any = lazy.load("threadpoolctl")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let linear algebra take one thread in the block."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


@cache
def _controller() -> Any:
    return threadpoolctl.ThreadpoolController()
