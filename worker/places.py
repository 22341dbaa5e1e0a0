"""Places of jobs in the queue: fair between owners, and in the order that an owner wants.

Owners take turns (start-time fair queuing, Goyal et al. 1996); `queue.py` tells how.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

WaitingJob = Sequence[Any]
"""Id, place, priority of its owner, and the rank that moved it to the front, if any did."""


def next_place(own: int | None, started: int | None, waiting: int | None) -> int:
    """The place of an owner's next job.

    Args:
        own: The last place of the owner's jobs that are queued or running, if there are any.
        started: The last place of all running jobs, if there are any.
        waiting: The first place of all queued jobs, if there are any.
    """
    return 1 + max(own or 0, started if started is not None else (waiting or 1) - 1)


def apart(places: Iterable[int]) -> list[int]:
    """Places in ascending order, no two the same: equal ones move behind each other.

    Jobs that are queued at the same moment may have been given the same place.
    """
    moved: list[int] = []
    for place in sorted(places):
        moved.append(max(place, moved[-1] + 1) if moved else place)
    return moved


def in_own_order(jobs: Iterable[WaitingJob]) -> list[WaitingJob]:
    """Those moved to the front, the last moved first; then by priority; then by age.

    Args:
        jobs: The queued jobs of an owner, by age.
    """
    return sorted(jobs, key=lambda job: (-int(job[3] or 0), job[2] or 0))


def rank_in_front(jobs: Iterable[WaitingJob], now: int) -> int:
    """The rank that moves a job before all others of its owner, whatever the clock has done.

    Args:
        jobs: The queued jobs of the owner.
        now: The time [microseconds since 1970].
    """
    return max([now, *(int(job[3] or 0) + 1 for job in jobs)])
