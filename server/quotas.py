"""Quotas: how much a key may keep and ask for."""

from __future__ import annotations

import threading
import time

from chamfer_morph.schemas import JobState
from chamfer_morph.server.database.meshes import MeshStore
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage

DISK_SECONDS = 30.0
"""How long a measured use of disk is believed."""


class Quotas:
    """The quotas of each key. Calls block."""

    def __init__(
        self, settings: Settings, storage: Storage, queue: JobQueue, meshes: MeshStore
    ) -> None:
        self._settings = settings
        self._storage = storage
        self._queue = queue
        self._meshes = meshes
        self._disk: dict[str, tuple[float, int]] = {}
        self._lock = threading.Lock()

    def check_jobs(self, owner: str, adding: int = 1) -> None:
        """Refuse more unfinished jobs than a key may have, and jobs of a key whose disk is full.

        Raises:
            ProblemError: 429 or 413.
        """
        counts = self._queue.counts(owner)
        unfinished = counts[JobState.QUEUED] + counts[JobState.RUNNING]
        limit = self._settings.queued_jobs_per_key
        if unfinished + adding > limit:
            cause = f"This key has {unfinished} unfinished jobs, and may have {limit}."
            raise _refusal(429, cause, "Wait for some to finish, or cancel them.")
        self.check_disk(owner)

    def check_meshes(self, owner: str) -> None:
        """Refuse more uploads than a key may keep, or any when its disk is full.

        Raises:
            ProblemError: 429 or 413.
        """
        count, _ = self._meshes.totals(owner)
        limit = self._settings.meshes_per_key
        if count >= limit:
            cause = f"This key keeps {count} meshes, and may keep {limit}."
            raise _refusal(429, cause, "Delete those that are not needed any more.")
        self.check_disk(owner)

    def check_disk(self, owner: str) -> None:
        """Refuse a key whose meshes and jobs fill the disk that it may fill.

        Raises:
            ProblemError: 413.
        """
        used, limit = self.used_bytes(owner), self._settings.disk_bytes_per_key
        if used >= limit:
            gigabytes, most = f"{used / 1e9:.1f} GB", f"{limit / 1e9:.1f} GB"
            cause = f"The meshes and jobs of this key fill {gigabytes}, and may fill {most}."
            raise _refusal(413, cause, "Delete jobs or meshes that are not needed any more.")

    def available_bytes(self, owner: str) -> int:
        """Disk that a key may still fill, measured now [bytes].

        Raises:
            ProblemError: 413, there is none.
        """
        self.invalidate(owner)
        self.check_disk(owner)
        return max(self._settings.disk_bytes_per_key - self.used_bytes(owner), 0)

    def used_bytes(self, owner: str) -> int:
        """Disk that a key fills, measured within the last half minute [bytes]."""
        with self._lock:
            measured_at, used = self._disk.get(owner, (float("-inf"), 0))
            if time.monotonic() - measured_at > DISK_SECONDS:
                used = self._meshes.totals(owner)[1] + self._job_bytes(owner)
                self._disk[owner] = (time.monotonic(), used)
            return used

    def invalidate(self, owner: str) -> None:
        """Something of this key has been made or deleted."""
        self._disk.pop(owner, None)

    def _job_bytes(self, owner: str) -> int:
        return sum(self._storage.job_bytes(record.id) for record in self._queue.all(owner=owner))


def _refusal(status: int, cause: str, remedy: str) -> ProblemError:
    return ProblemError(status, cause, remedy, headers={"Retry-After": "60"})
