"""Taichi's threads, each kept on a core of its own where they take all cores.

A loop wakes them all. Linux often puts two that wake at once on the same core, and moves one to the
idle core milliseconds later, when most loops would have ended.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def pinned(threads: int) -> Iterator[None]:
    """Pin the threads that loops are shared out to; they are the last that begin in this context.

    Where there are fewer than cores they are left alone: other processes may take the same cores.

    Args:
        threads: Their number; 0: one for each core.
    """
    if sys.platform != "linux":
        yield
        return
    before = _threads()
    yield
    cores = sorted(os.sched_getaffinity(0))
    begun = sorted(_threads() - before)[-len(cores) :]
    if threads in (0, len(cores)) and len(begun) == len(cores) > 1:
        for thread, core in zip(begun, cores, strict=True):
            with suppress(OSError):  # not every sandbox allows it
                os.sched_setaffinity(thread, {core})


def _threads() -> set[int]:
    """Those of this process, by their numbers, which grow."""
    return {int(thread) for thread in os.listdir("/proc/self/task")}
