"""Quotas: how much a key may keep and ask for."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial

from chamfer_morph.server.database.meshes import MeshStore
from chamfer_morph.server.database.reservations import Reservation, Reservations
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.retention.job_sizes import JobSizes
from chamfer_morph.worker.settings import Settings

DISK_SECONDS = 30.0
"""How long a measured use of disk is believed."""

SHARE_LINKS = 20
"""Links to one job that may be there at the same time."""

PENDING_TESTS = 10
"""Tests of one webhook that may wait for their delivery."""


class Incoming:
    """An upload on its way in, or several, which count as meshes and fill the disk already.

    Args:
        quotas: Where it counts.
        owner: Whose it is.
        room: Disk that the owner may still fill, with all that is on its way in [bytes].
        reservation: By which it counts as a mesh.
    """

    def __init__(self, quotas: Quotas, owner: str, room: int, reservation: Reservation) -> None:
        self._quotas = quotas
        self._owner = owner
        self._room = room
        self._reservation = reservation
        self._bytes = 0

    def keep_place(self) -> None:
        """See that it still counts as a mesh, however long it took to come. Blocks.

        Raises:
            ProblemError: 429, it has lost its place, and others have taken it.
        """
        self._reservation.renew()
        self._quotas.check_meshes(self._reservation)

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
                "The meshes, jobs and uploads of this key use up its disk quota.",
                "Delete jobs or meshes that are no longer needed.",
            )

    def close(self) -> None:
        """Its temporary files are gone."""
        self._quotas.arrived(self._owner, -self._bytes)
        self._bytes = 0


class Quotas:
    """The quotas of each key. Calls block.

    What is let in counts at once, however many requests come at the same time to however many API
    processes. Bytes on their way in are counted within each of these.
    """

    def __init__(
        self,
        settings: Settings,
        queue: JobQueue,
        meshes: MeshStore,
        sizes: JobSizes,
        reservations: Reservations,
    ) -> None:
        self._settings = settings
        self._queue = queue
        self._meshes = meshes
        self._sizes = sizes
        self._disk: dict[str, tuple[float, int]] = {}
        self._lock = threading.Lock()
        self._reservations = reservations
        self._bytes_let_in: Counter[str] = Counter()
        self._promised: Counter[str] = Counter()
        self._changes: Counter[str] = Counter()

    @contextmanager
    def letting_in_jobs(
        self, owner: str, adding: int = 1, *, needed_bytes: int = 0
    ) -> Iterator[Callable[[], None]]:
        """Refuse more unfinished jobs than a key may have, and jobs that its disk has no room for.

        Args:
            owner: Name of the key.
            adding: How many jobs it wants to add.
            needed_bytes: Disk that these will fill [bytes].

        Yields:
            To be called once each of the jobs is in the queue.

        Raises:
            ProblemError: 429 or 413.
        """
        limit = self._settings.queued_jobs_per_key
        cause = "This key has {there} unfinished jobs; the limit is {limit}."
        remedy = "Wait for some to finish, or cancel them."
        there = partial(self._queue.unfinished, owner)
        with (
            self.promising_disk(owner, needed_bytes),
            self._letting_in("jobs", owner, adding, limit, there, cause, remedy) as reserved,
        ):
            yield reserved.release_one

    @contextmanager
    def submitting_sweep(self, sweep_id: str) -> Iterator[bool]:
        """Tell whether no other request submits the same sweep at this moment."""
        with self._reservations.reserving("sweep", sweep_id, 1, 1, lambda: 0) as reserved:
            yield not reserved.refused

    def letting_in_webhook(
        self, owner: str, count: Callable[[], int]
    ) -> AbstractContextManager[Reservation]:
        """Refuse more webhooks than a key may have.

        Args:
            owner: Name of the key.
            count: Counts those it has.

        Raises:
            ProblemError: 429.
        """
        cause = "This key has {there} webhooks; the limit is {limit}."
        remedy = "Delete those that are no longer needed."
        limit = self._settings.webhooks_per_key
        return self._letting_in("webhooks", owner, 1, limit, count, cause, remedy)

    def letting_in_share_link(
        self, job_id: str, count: Callable[[], int]
    ) -> AbstractContextManager[Reservation]:
        """Refuse more share links than a job may have.

        Args:
            job_id: The job.
            count: Counts those it has.

        Raises:
            ProblemError: 429.
        """
        cause = "This job has {there} share links; the limit is {limit}."
        remedy = "Revoke those that are no longer needed."
        return self._letting_in("share links", job_id, 1, SHARE_LINKS, count, cause, remedy)

    def letting_in_test(
        self, webhook_id: str, count: Callable[[], int]
    ) -> AbstractContextManager[Reservation]:
        """Refuse more tests of a webhook than may wait for their delivery.

        Args:
            webhook_id: The webhook.
            count: Counts those that wait.

        Raises:
            ProblemError: 429.
        """
        cause = "{there} tests of this webhook are waiting, the most that are allowed."
        remedy = "Wait until they are delivered or have failed."
        return self._letting_in("tests", webhook_id, 1, PENDING_TESTS, count, cause, remedy)

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
        with self._reservations.reserving(
            "meshes", owner, adding, limit, lambda: self._meshes.totals(owner)[0]
        ) as reserved:
            self.check_meshes(reserved)
            incoming = Incoming(self, owner, room, reserved)
            try:
                yield incoming
            finally:
                incoming.close()

    def check_meshes(self, reserved: Reservation) -> None:
        """Refuse meshes that there is no room for.

        Raises:
            ProblemError: 429.
        """
        if reserved.refused:
            limit = self._settings.meshes_per_key
            cause = f"This key has {reserved.there} meshes; the limit is {limit}."
            raise _refusal(429, cause, "Delete those that are no longer needed.")

    @contextmanager
    def storing_mesh(self, owner: str, size_bytes: int) -> Iterator[None]:
        """Refuse a file that fills more than the disk that a key may fill, with all its others.

        Raises:
            ProblemError: 413.
        """
        self.invalidate(owner)
        limit = self._settings.disk_bytes_per_key
        of_jobs = self._sizes.of(owner)  # takes long, and others wait for who counts
        with self._reservations.reserving(
            "bytes", owner, size_bytes, limit, lambda: self._meshes.totals(owner)[1] + of_jobs
        ) as reserved:
            if reserved.refused:
                raise _disk_is_full(reserved.there, limit)
            yield

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
            raise _disk_is_full(used, limit)

    @contextmanager
    def promising_disk(self, owner: str, needed_bytes: int) -> Iterator[None]:
        """Refuse jobs that do not fit on the disk that their key may fill.

        They count until the end of the body, when they are in the queue, and count there.

        Args:
            owner: Name of the key.
            needed_bytes: What the jobs will fill [bytes].

        Raises:
            ProblemError: 413.
        """
        self.check_disk(owner)
        while not self._promise(owner, needed_bytes):
            pass
        queued = False
        try:
            yield
            queued = True
        finally:
            with self._lock:
                self._promised[owner] -= needed_bytes
                measured = self._disk.get(owner)
                self._forget_measured(owner)
                if queued and measured:  # spares measuring anew for each job that is let in
                    at, used = measured
                    self._disk[owner] = at, used + needed_bytes

    def _promise(self, owner: str, needed_bytes: int) -> bool:
        """Count jobs that are let in; False if something has changed as the disk was measured."""
        change, used = self._measured(owner)
        limit = self._settings.disk_bytes_per_key
        with self._lock:
            if change != self._changes[owner]:
                return False
            left = limit - used - self._promised[owner]
            if needed_bytes > left:
                raise _refusal(
                    413,
                    f"This would take about {needed_bytes / 1e9:,.1f} GB of disk, and this key has "
                    f"{max(left, 0) / 1e9:,.1f} GB left, with all that its unfinished jobs are "
                    "expected to fill.",
                    "Request fewer `frames`, states (`states_every`) or particles; or delete "
                    "jobs or meshes that are no longer needed.",
                )
            self._promised[owner] += needed_bytes
        return True

    def available_bytes(self, owner: str) -> int:
        """Disk that a key may still fill, measured now [bytes].

        Raises:
            ProblemError: 413, there is none.
        """
        self.invalidate(owner)
        self.check_disk(owner)
        return max(self._settings.disk_bytes_per_key - self.used_bytes(owner), 0)

    def used_bytes(self, owner: str) -> int:
        """Disk that a key fills, and its unfinished jobs will [bytes].

        Measured within the last half minute.
        """
        return self._measured(owner)[1]

    def _measured(self, owner: str) -> tuple[int, int]:
        """The number of the last change that is known of, and what is used after it [bytes]."""
        with self._lock:
            change = self._changes[owner]
            measured_at, used = self._disk.get(owner, (float("-inf"), 0))
        if time.monotonic() - measured_at > DISK_SECONDS:
            used = self._measured_bytes(owner)
            with self._lock:
                if change == self._changes[owner]:
                    self._disk[owner] = (time.monotonic(), used)
        return change, used

    @contextmanager
    def _letting_in(
        self,
        kind: str,
        key: str,
        adding: int,
        limit: int,
        count: Callable[[], int],
        cause: str,
        remedy: str,
    ) -> Iterator[Reservation]:
        """Keep places, see `Reservations`; without room, the problem has this cause and remedy."""
        with self._reservations.reserving(kind, key, adding, limit, count) as reserved:
            if reserved.refused:
                raise _refusal(429, cause.format(there=reserved.there, limit=limit), remedy)
            yield reserved

    def _measured_bytes(self, owner: str) -> int:
        return self._meshes.totals(owner)[1] + self._sizes.of(owner)

    def invalidate(self, owner: str) -> None:
        """Something of this key has been made or deleted."""
        with self._lock:
            self._forget_measured(owner)

    def _forget_measured(self, owner: str) -> None:
        self._changes[owner] += 1
        self._disk.pop(owner, None)

    def job_changed(self, job: str, owner: str) -> None:
        """Files of a job have been made or deleted."""
        self._sizes.measure(job)
        self.invalidate(owner)

    def job_gone(self, job: str, owner: str) -> None:
        """A job has been deleted, or goes on."""
        self._sizes.forget(job)
        self.invalidate(owner)


def _disk_is_full(used: int, limit: int) -> ProblemError:
    gigabytes, most = f"{used / 1e9:.1f} GB", f"{limit / 1e9:.1f} GB"
    cause = f"The meshes and jobs of this key take {gigabytes} of disk; the limit is {most}."
    return _refusal(413, cause, "Delete jobs or meshes that are no longer needed.")


def _refusal(status: int, cause: str, remedy: str) -> ProblemError:
    return ProblemError(status, cause, remedy, headers={"Retry-After": "60"})
