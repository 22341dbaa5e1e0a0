"""Quotas: how much a key may keep and ask for."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from chamfer_morph.server.database.meshes import MeshStore
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.retention.job_sizes import JobSizes
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage

DISK_SECONDS = 30.0
"""How long a measured use of disk is believed."""


class Incoming:
    """An upload on its way in, or several, which count as meshes and fill the disk already.

    Args:
        quotas: Where it counts.
        owner: Whose it is.
        room: Disk that the owner may still fill, with all that is on its way in [bytes].
    """

    def __init__(self, quotas: Quotas, owner: str, room: int) -> None:
        self._quotas = quotas
        self._owner = owner
        self._room = room
        self._bytes = 0

    def add(self, count: int) -> None:
        """Count what has come.

        Raises:
            ProblemError: 413, the disk of the key is full with it.
        """
        self._bytes += count
        if self._quotas.arrived(self._owner, count) > self._room:
            self.close()  # at once, so that the others may go on
            raise _refusal(
                413,
                "The meshes, jobs and uploads of this key fill all the disk that it may fill.",
                "Delete jobs or meshes that are not needed any more.",
            )

    def close(self) -> None:
        """Its temporary files are gone."""
        self._quotas.arrived(self._owner, -self._bytes)
        self._bytes = 0


class Quotas:
    """The quotas of each key. Calls block.

    What is let in counts at once, however many requests come at the same time. That takes one API
    process, as there is.
    """

    def __init__(
        self,
        settings: Settings,
        storage: Storage,
        queue: JobQueue,
        meshes: MeshStore,
        sizes: JobSizes,
    ) -> None:
        self._settings = settings
        self._storage = storage
        self._queue = queue
        self._meshes = meshes
        self._sizes = sizes
        self._disk: dict[str, tuple[float, int]] = {}
        self._lock = threading.Lock()
        self._jobs_let_in: Counter[str] = Counter()
        self._meshes_let_in: Counter[str] = Counter()
        self._bytes_let_in: Counter[str] = Counter()

    @contextmanager
    def letting_in_jobs(self, owner: str, adding: int = 1) -> Iterator[Callable[[], None]]:
        """Refuse more unfinished jobs than a key may have, and jobs of a key whose disk is full.

        Yields:
            To be called once each of the jobs is in the queue.

        Raises:
            ProblemError: 429 or 413.
        """
        self.check_disk(owner)
        limit = self._settings.queued_jobs_per_key
        with self._lock:
            unfinished = self._queue.unfinished(owner) + self._jobs_let_in[owner]
            if unfinished + adding > limit:
                cause = f"This key has {unfinished} unfinished jobs, and may have {limit}."
                raise _refusal(429, cause, "Wait for some to finish, or cancel them.")
            self._jobs_let_in[owner] += adding
        left = adding

        def queued() -> None:
            nonlocal left
            left -= 1
            with self._lock:
                self._jobs_let_in[owner] -= 1

        try:
            yield queued
        finally:
            with self._lock:
                self._jobs_let_in[owner] -= left

    @contextmanager
    def letting_in_meshes(self, owner: str, adding: int = 1) -> Iterator[Incoming]:
        """Refuse more uploads than a key may keep, or any when its disk is full.

        They count until the end of the body, when they are stored or gone.

        Raises:
            ProblemError: 429 or 413.
        """
        self.check_disk(owner)
        room = self._settings.disk_bytes_per_key - self.used_bytes(owner)
        limit = self._settings.meshes_per_key
        with self._lock:
            count = self._meshes.totals(owner)[0] + self._meshes_let_in[owner]
            if count + adding > limit:
                cause = f"This key keeps {count} meshes, and may keep {limit}."
                raise _refusal(429, cause, "Delete those that are not needed any more.")
            self._meshes_let_in[owner] += adding
        incoming = Incoming(self, owner, room)
        try:
            yield incoming
        finally:
            incoming.close()
            with self._lock:
                self._meshes_let_in[owner] -= adding

    def arrived(self, owner: str, count: int) -> int:
        """Count what has come in [bytes]; the answer is what all uploads on their way have."""
        with self._lock:
            self._bytes_let_in[owner] += count
            return self._bytes_let_in[owner]

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
        measured_at, used = self._disk.get(owner, (float("-inf"), 0))
        if time.monotonic() - measured_at > DISK_SECONDS:
            used = self._meshes.totals(owner)[1] + self._sizes.of(owner)
            self._disk[owner] = (time.monotonic(), used)
        return used

    def invalidate(self, owner: str) -> None:
        """Something of this key has been made or deleted."""
        self._disk.pop(owner, None)

    def job_changed(self, job: str, owner: str) -> None:
        """Files of a job have been made or deleted."""
        self._sizes.measure(job)
        self.invalidate(owner)

    def job_gone(self, job: str, owner: str) -> None:
        """A job has been deleted, or goes on."""
        self._sizes.forget(job)
        self.invalidate(owner)


def _refusal(status: int, cause: str, remedy: str) -> ProblemError:
    return ProblemError(status, cause, remedy, headers={"Retry-After": "60"})
