"""Small matrices on one thread: others would only wait, and their number would change the sums."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import lazy_loader as lazy

threadpoolctl: Any = lazy.load("threadpoolctl")

_one_at_a_time = threading.RLock()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let linear algebra take one thread in the block, which one thread enters at a time.

    The limit is the whole process's, and whoever leaves the block first would lift it.
    """
    with _one_at_a_time, _controller().limit(limits=1, user_api="blas"):
        yield


@cache
def _controller() -> Any:
    return threadpoolctl.ThreadpoolController()
