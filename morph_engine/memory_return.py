"""Memory that was freed goes back to the system, rather than being kept for later."""

from __future__ import annotations

import ctypes
import sys


def return_free_memory() -> None:
    """Give pages of the heap that nothing uses back, where the C library can: glibc."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim:
            trim(0)
