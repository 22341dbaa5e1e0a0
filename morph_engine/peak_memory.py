"""How much memory this process has needed at most."""

from __future__ import annotations

import sys

import psutil


def peak_memory() -> int:
    """Largest resident memory of this process so far [bytes]."""
    if sys.platform == "win32":
        return int(psutil.Process().memory_info().peak_wset)
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return int(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)
