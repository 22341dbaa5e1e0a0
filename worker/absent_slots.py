"""Worker slots that nobody works as any more are forgotten after a day."""

from __future__ import annotations

import time

import sqlalchemy as sa

from chamfer_morph.worker.locks import living, try_lock
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.slots import WorkerSlots

ABSENT_SECONDS = 86_400.0


class AbsentSlots:
    """Slots that had no time to say that they end, such as those of hosts that are gone.

    Args:
        settings: Where the locks are.
        engine: The database of the queue.
        queue: The queue.
    """

    def __init__(self, settings: Settings, engine: sa.Engine, queue: JobQueue) -> None:
        self._settings = settings
        self._engine = engine
        self._queue = queue
        self._slots = WorkerSlots(engine)
        self._since: dict[str, float] = {}

    def forget(self) -> list[str]:
        """Forget those without a lock and a job for a day, as far as this process has seen.

        Returns:
            Names of the forgotten slots.
        """
        slots = [name for name, paused in self._slots.all().items() if not paused]
        present = living(self._settings, self._engine, slots) | self._queue.running().keys()
        now = time.monotonic()
        self._since = {name: self._since.get(name, now) for name in slots if name not in present}
        forgotten = []
        for name, since in self._since.items():
            lock = try_lock(self._settings, name) if now - since >= ABSENT_SECONDS else None
            if lock is not None:  # whoever begins now waits for it, and registers then
                self._slots.unregister(name)
                lock.release()
                forgotten.append(name)
        return forgotten
