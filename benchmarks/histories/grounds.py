"""Where a history is played: the queue with a real database and folders, or in memory.

In both, `JobQueue`, the states, the order of jobs, the locks and the janitor are the real ones.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from dbos import error as dbos_error

from benchmarks.histories.memory_queue import MemoryQueue, MemoryStorage
from chamfer_morph.schemas import Outcome
from chamfer_morph.worker import locks
from chamfer_morph.worker.dbos_adapter import SERIALIZER
from chamfer_morph.worker.own_queue import QUEUE
from chamfer_morph.worker.queue import APPLICATION_VERSION, JobQueue
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage


class Ground(Protocol):
    """What workers do to the queue and to the folders of jobs; calls of owners go to `queue`."""

    settings: Settings
    queue: JobQueue

    def claim(self, slot: str, token: str) -> Collection[str]:
        """Start the next job; the id of it, if there is one."""

    def owns(self, job: str, token: str) -> bool:
        """Whether a job is still that of the run with this token."""

    def write_outcome(self, job: str, status: str, outcome: Outcome, token: str) -> bool:
        """End a job; False if it is not that of the run any more."""

    def queue_again(self, slot: str) -> None:
        """What a DBOS process of this name does with its jobs at its start."""

    def begin(self, job: str) -> bool:
        """What a worker does first; returns whether there are frames of before."""

    def add_frame(self, job: str) -> None:
        """Compute something."""

    def remove(self, job: str) -> None:
        """Delete what a job has left."""

    def close(self) -> None:
        """Give everything back."""


def try_lock(ground: Ground, slot: str) -> Any:
    """The lock of a worker slot, or None."""
    return locks.try_lock(ground.settings, slot)


class DatabaseGround:
    """SQLite or Postgres, and the very statements by which DBOS changes jobs.

    Args:
        folder: Data directory.
        url: Address of the Postgres database; SQLite if empty.
    """

    def __init__(self, folder: Path, url: str = "") -> None:
        self.settings = Settings(_env_file=None, data_dir=folder, database_url=url)
        self.queue = JobQueue(self.settings)
        self.queue.migrate()
        self.storage = Storage(folder)
        self.dbos: Any = self.queue._client._sys_db
        self._lane = self.queue._client.retrieve_queue(QUEUE)

    def claim(self, slot: str, token: str) -> Collection[str]:
        claimed, _ = self.dbos.start_queued_workflows(
            self._lane, slot, APPLICATION_VERSION, None, owner_xid=token
        )
        return claimed

    def owns(self, job: str, token: str) -> bool:
        try:
            with self.dbos.engine.begin() as connection:
                self.dbos._check_owner_txn(connection, job, token)
        except dbos_error.DBOSWorkflowConflictIDError:
            return False
        return True

    def write_outcome(self, job: str, status: str, outcome: Outcome, token: str) -> bool:
        output = SERIALIZER.serialize(outcome.model_dump(mode="json"))
        return self.dbos.update_workflow_outcome(job, status, output=output, owner_xid=token)

    def queue_again(self, slot: str) -> None:
        for pending in self.dbos.get_pending_workflows(slot, APPLICATION_VERSION):
            self.dbos.reenqueue_for_recovery(pending.workflow_id, [slot], QUEUE)

    def begin(self, job: str) -> bool:
        self.storage.discard_if_marked(job, wait_seconds=0)
        folder = self.storage.job_dir(job)
        folder.mkdir(exist_ok=True)
        return (folder / "frames").exists()

    def add_frame(self, job: str) -> None:
        with suppress(FileNotFoundError):
            (self.storage.job_dir(job) / "frames").touch()

    def remove(self, job: str) -> None:
        self.storage.remove_job(job)

    def close(self) -> None:
        self.queue.close()


class MemoryGround:
    """Rows and folders in memory, changed as DBOS and `Storage` do.

    Args:
        folder: For locks.
    """

    def __init__(self, folder: Path) -> None:
        self.settings = Settings(_env_file=None, data_dir=folder)
        (folder / "locks").mkdir(exist_ok=True)
        self.storage = MemoryStorage()
        self.queue = MemoryQueue(self.storage)
        self.dbos = self.queue.rows

    def claim(self, slot: str, token: str) -> Collection[str]:
        return self.dbos.claim(slot, token)

    def owns(self, job: str, token: str) -> bool:
        return self.dbos.owner_token(job) == token

    def write_outcome(self, job: str, status: str, outcome: Outcome, token: str) -> bool:
        return self.dbos.update_workflow_outcome(job, status, output=outcome, owner_xid=token)

    def queue_again(self, slot: str) -> None:
        self.dbos.queue_again(slot)

    def begin(self, job: str) -> bool:
        self.storage.discard_if_marked(job, wait_seconds=0)
        self.storage.make(job)
        return self.storage.has_frames(job)

    def add_frame(self, job: str) -> None:
        self.storage.add_frame(job)

    def remove(self, job: str) -> None:
        self.storage.remove_job(job)

    def close(self) -> None:
        pass
