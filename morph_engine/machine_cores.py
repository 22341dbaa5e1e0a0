"""How many cores there are: the machine's, or fewer where this process may not use all of them."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

from morph_engine.control_groups import ROOT, groups


def usable_cores(root: Path = ROOT) -> int:
    """Cores that this process may use, by its affinity and the quota of its control groups."""
    if sys.platform == "linux":
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    return min([cores, *(max(1, math.ceil(quota)) for quota in _quotas(root))])


def _quotas(root: Path) -> list[float]:
    """CPU time that groups may take, of one core's [1]."""
    found = []
    for group in groups("cpu", root):
        for files in (["cpu.max"], ["cpu.cfs_quota_us", "cpu.cfs_period_us"]):  # version 2, 1
            try:
                words = " ".join((group / file).read_text(encoding="ascii") for file in files)
                quota, period = map(int, words.split())
            except (OSError, ValueError):  # there is no such file, or "max"
                continue
            if quota > 0:  # -1: none
                found.append(quota / period)
    return found
