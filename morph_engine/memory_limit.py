"""A limit on the memory of this process, kept by the system, and whether one was reached."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

RESERVED_BYTES = 2 << 30
"""What libraries reserve and do not touch: Taichi 1 GiB, Python's and others' pools the rest."""

RESERVED_BYTES_PER_CORE = 64 << 20
"""The same for each core: stacks and buffers of threads."""

OUT_OF_MEMORY = ("memory allocation", "CUDA_ERROR_OUT_OF_MEMORY")
"""What Taichi says when it gets no more memory."""


def limit_memory(limit_bytes: int) -> None:
    """Let allocations fail that would take this process far beyond a limit, on Linux.

    What counts is what a process may write to and shares with nobody (RLIMIT_DATA), touched or not;
    so the system lets it have what libraries reserve, besides. All addresses (RLIMIT_AS) would be
    too many: compilers and drivers reserve of them what no machine has.

    Args:
        limit_bytes: Memory that it may take [bytes].
    """
    if sys.platform != "linux":
        return
    import resource

    reserved = RESERVED_BYTES + RESERVED_BYTES_PER_CORE * (os.cpu_count() or 1)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = limit_bytes + reserved
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


@contextmanager
def uncounted() -> Iterator[None]:
    """Let this process have what it reserves in here and does not touch beside its limit."""
    if sys.platform != "linux":
        yield
        return
    import resource

    limit, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if limit == resource.RLIM_INFINITY:
        yield
        return
    before = _counted_bytes()
    resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
    try:
        yield
    finally:
        limit += max(_counted_bytes() - before, 0)
        if hard != resource.RLIM_INFINITY:
            limit = min(limit, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def _counted_bytes() -> int:
    """What counts for that limit, and the stack, which is small."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[5]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def be_ended_first() -> None:
    """Let Linux end this process before all others where memory is short, such as a database."""
    path = Path("/proc/self/oom_score_adj")
    if path.exists():
        path.write_text("1000", encoding="ascii")


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an exception says that there is no more memory, of the machine or the device."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and any(words in str(error) for words in OUT_OF_MEMORY)
    )
