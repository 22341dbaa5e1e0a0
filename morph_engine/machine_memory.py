"""How much memory there is: the machine's, or less where a control group limits it."""

from __future__ import annotations

from pathlib import Path

import psutil

from morph_engine.control_groups import ROOT, groups

LIMITS = (
    ("memory.max", "memory.current"),  # version 2
    ("memory.limit_in_bytes", "memory.usage_in_bytes"),  # version 1
)
"""Files of a group that hold its limit and what it uses [bytes]."""


def total_memory(root: Path = ROOT) -> int:
    """Memory of this machine, or of the smallest group that this process is in [bytes]."""
    total = int(psutil.virtual_memory().total)
    return min([total, *(limit for limit, _ in _limits(root))])


def free_memory(root: Path = ROOT) -> int:
    """Memory that is left, on this machine and in the groups that this process is in [bytes]."""
    available = int(psutil.virtual_memory().available)
    return min([available, *(max(limit - used, 0) for limit, used in _limits(root))])


def _limits(root: Path) -> list[tuple[int, int]]:
    found = []
    for group in groups("memory", root):
        for names in LIMITS:
            try:
                limit, used = (int((group / name).read_text(encoding="ascii")) for name in names)
            except (OSError, ValueError):  # there is no such file, or "max"
                continue
            found.append((limit, used - _dropped_when_needed(group)))
    return found


def _dropped_when_needed(group: Path) -> int:
    """What a group's memory holds of files that nobody has used lately [bytes]."""
    try:
        lines = (group / "memory.stat").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    sizes = dict(line.split(maxsplit=1) for line in lines)
    return int(sizes.get("total_inactive_file") or sizes.get("inactive_file") or 0)
