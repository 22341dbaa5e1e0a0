"""Where a history is played: the queue with a real database and folders, or in memory.

In both, `JobQueue`, the states, the order of jobs, the locks and the janitor are the real ones.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any, Protocol

from dbos import error as dbos_error

from benchmarks.histories.memory_queue import MemoryQueue, MemoryStorage
from chamfer_morph.schemas import Outcome
from chamfer_morph.worker import event_log, locks
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

    def begin(self, job: str) -> int:
        """What an engine does first: tell of frames of before that nobody was told of.

        Returns:
            How many frames of before there are.
        """

    def save_frame(self, job: str) -> None:
        """Compute the next frame; events do not tell of it yet."""

    def tell(self, job: str) -> None:
        """Tell of the last frame."""

    def events(self, job: str) -> list[int]:
        """Indices of the frames that events tell of, in the order of their ids."""

    def remove(self, job: str) -> None:
        """Delete what a job has left."""

    def close(self) -> None:
        """Give everything back."""


def try_lock(ground: Ground, slot: str) -> Any:
    """The lock of a worker slot, or None."""
    return locks.try_lock(ground.settings, slot)


def forget(ground: Ground, job: str) -> None:
    """Take a job out of the queue, in whatever state, and delete what it has left."""
    ground.queue._client.delete_workflow(job)
    ground.remove(job)


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

    def begin(self, job: str) -> int:
        self.storage.discard_if_marked(job, wait_seconds=0)
        self.storage.job_dir(job).mkdir(exist_ok=True)
        count, log = self._frames(job), self.storage.events(job)
        told = event_log.told_frames(log.read())
        for frame in range(count):
            if frame not in told:
                log.append("frame", {"frame": frame})
        return count

    def save_frame(self, job: str) -> None:
        with (self.storage.job_dir(job) / "frames").open("ab") as file:
            file.write(b".")

    def tell(self, job: str) -> None:
        self.storage.events(job).append("frame", {"frame": self._frames(job) - 1})

    def events(self, job: str) -> list[int]:
        return [event.data["frame"] for event in self.storage.events(job).read()]

    def _frames(self, job: str) -> int:
        try:
            return (self.storage.job_dir(job) / "frames").stat().st_size
        except FileNotFoundError:
            return 0

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

    def begin(self, job: str) -> int:
        self.storage.discard_if_marked(job, wait_seconds=0)
        folder = self.storage.make(job)
        folder.told += [frame for frame in range(folder.frames) if frame not in folder.told]
        return folder.frames

    def save_frame(self, job: str) -> None:
        self.storage.make(job).frames += 1

    def tell(self, job: str) -> None:
        folder = self.storage.make(job)
        folder.told.append(folder.frames - 1)

    def events(self, job: str) -> list[int]:
        return [*self.storage.make(job).told]

    def remove(self, job: str) -> None:
        self.storage.remove_job(job)

    def close(self) -> None:
        pass
