"""How much memory there is: the machine's, or less where a control group limits it (containers)."""

from __future__ import annotations

from pathlib import Path

import psutil

LIMITS = (
    ("memory.max", "memory.current"),  # version 2
    ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),  # version 1
)
"""Files of a container's own group that hold its limit and what it uses [bytes]."""

GROUP = Path("/sys/fs/cgroup")


def total_memory(group: Path = GROUP) -> int:
    """Memory of this machine, or of the group that this process is in [bytes]."""
    total = int(psutil.virtual_memory().total)
    return min([total, *(limit for limit, _ in _limits(group))])


def free_memory(group: Path = GROUP) -> int:
    """Memory that is left, on this machine and in the group that this process is in [bytes]."""
    available = int(psutil.virtual_memory().available)
    return min([available, *(max(limit - used, 0) for limit, used in _limits(group))])


def _limits(group: Path) -> list[tuple[int, int]]:
    found = []
    for names in LIMITS:
        try:
            limit, used = (int((group / name).read_text(encoding="ascii")) for name in names)
        except (OSError, ValueError):  # there is no such group, or "max"
            continue
        found.append((limit, used))
    return found
