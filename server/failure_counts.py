"""How many jobs have failed since this process began, by kind; each failure is read once."""

from __future__ import annotations

import threading
import time
from collections import Counter

from chamfer_morph.worker.job_listing import PAGE
from chamfer_morph.worker.queue import JobQueue

OVERLAP_MILLISECONDS = 60_000
"""Rows that finished so long before the last one are looked at again: they may come late, and
clocks differ."""


class FailureCounts:
    """Counts failures from now on. Calls block.

    Those before are left out: they get fewer when jobs are deleted or queued again, which a counter
    must not.
    """

    def __init__(self, queue: JobQueue) -> None:
        self._queue = queue
        self._begun = round(time.time() * 1000)
        self._recent: dict[str, int] = {}
        self._lock = threading.Lock()
        self.since_last_call()

    def since_last_call(self) -> Counter[str]:
        """Failures of each kind that no call has counted; a job that fails twice counts twice."""
        counts: Counter[str] = Counter()
        with self._lock:
            after = self._newest() - OVERLAP_MILLISECONDS, ""
            while page := self._queue.failed(after, PAGE):
                for job, at, kind in page:
                    if self._recent.get(job) != at:
                        self._recent[job] = at
                        counts[kind] += 1
                after = page[-1][1], page[-1][0]
            oldest = self._newest() - OVERLAP_MILLISECONDS
            self._recent = {job: at for job, at in self._recent.items() if at >= oldest}
        return counts

    def _newest(self) -> int:
        """When the last failure happened that is counted, or this began [ms since 1970].

        Never later than now: one by a clock that is ahead must not hide others.
        """
        last = max([self._begun, *self._recent.values()])
        return min(last, round(time.time() * 1000))
