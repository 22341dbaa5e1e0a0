"""The queue and the folders of jobs in memory, with DBOS's statements told again in Python.

`JobQueue` runs as it is above rows that are held here. Histories that are played on both show that
rows in memory change as those of a database do.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Collection
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

from dbos import error as dbos_error

from chamfer_morph.schemas import JobState
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.job_state import job_state
from chamfer_morph.worker.own_queue import PAUSED_QUEUE, QUEUE
from chamfer_morph.worker.places import apart, in_own_order, next_place, rank_in_front
from chamfer_morph.worker.queue import JobQueue


@dataclass
class Row:
    """A job's row."""

    id: str
    user: str
    place: int
    queue: str | None
    attributes: dict[str, Any]
    timeout: float
    created_at: int
    status: str = "ENQUEUED"
    executor: str | None = None
    token: str | None = None
    deadline: int | None = None
    completed_at: int | None = None
    output: Any = None

    @property
    def state(self) -> JobState:
        """Where the job stands."""
        ended, deadline = self.completed_at, self.deadline
        late = ended is not None and deadline is not None and ended >= deadline
        return job_state(self.status, late=late)

    @property
    def waits(self) -> bool:
        """Whether it may be started."""
        return self.status == "ENQUEUED" and self.queue == QUEUE

    @property
    def runs(self) -> bool:
        """Whether a slot holds it."""
        return self.status == "PENDING" and self.queue == QUEUE


class Rows:
    """The table, and what DBOS does to it under the names that it has there."""

    def __init__(self) -> None:
        self.of: dict[str, Row] = {}

    def enqueue(self, options: dict[str, Any], spec: Any) -> None:
        job = options["workflow_id"]
        if job in self.of:
            raise dbos_error.DBOSWorkflowIDInUseError(job)
        self.of[job] = Row(
            job,
            options["authenticated_user"],
            options["priority"],
            options["queue_name"],
            options["attributes"],
            options["workflow_timeout"],
            _now(),
        )

    def cancel_workflow(self, job: str) -> None:
        row = self.of.get(job)
        if row is not None and row.status not in ("SUCCESS", "ERROR"):
            row.status, row.token, row.queue, row.completed_at = "CANCELLED", None, None, _now()

    def rewind_workflow(self, job: str, *, application_version: str, queue_name: str) -> None:
        row = self.of.get(job)
        if row is None:
            raise dbos_error.DBOSNonExistentWorkflowError("target", job)
        if row.status in ("ENQUEUED", "PENDING"):
            raise dbos_error.DBOSException(f"Cannot rewind {job} ({row.status})")
        row.status, row.token, row.queue = "ENQUEUED", None, queue_name
        row.deadline = row.completed_at = row.output = None

    def delete_workflow(self, job: str) -> None:
        self.of.pop(job, None)

    def claim(self, slot: str, token: str) -> list[str]:
        waiting = [row for row in self.of.values() if row.waits]
        if not waiting:
            return []
        row = min(waiting, key=lambda row: (row.place, row.created_at))
        row.status, row.executor, row.token = "PENDING", slot, token
        if row.deadline is None:
            row.deadline = _now() + round(row.timeout * 1000)
        return [row.id]

    def owner_token(self, job: str) -> str | None:
        row = self.of.get(job)
        return row.token if row else None

    def update_workflow_outcome(
        self, job: str, status: str, *, output: Any, owner_xid: str | None = None
    ) -> bool:
        row = self.of.get(job)
        if row is None or row.status != "PENDING" or owner_xid not in (None, row.token):
            return False
        row.status, row.token, row.output, row.completed_at = status, None, output, _now()
        return True

    def queue_again(self, slot: str) -> None:
        for row in self.of.values():
            if row.status == "PENDING" and row.executor == slot:
                row.status, row.token, row.queue = "ENQUEUED", None, row.queue or QUEUE


class MemoryOwnQueue:
    """What `OwnQueue` does, by the same rules of order."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        self._paused: set[str] = set()

    def is_paused(self, owner: str) -> bool:
        return owner in self._paused

    def queue_of(self, owner: str) -> str:
        return PAUSED_QUEUE if self.is_paused(owner) else QUEUE

    def pause(self, owner: str) -> None:
        self._paused.add(owner)
        self.settle(owner)

    def unpause(self, owner: str, first_place: int) -> None:
        self._paused.discard(owner)
        for place, (job, *_) in enumerate(
            in_own_order(self._waiting(owner, PAUSED_QUEUE)), first_place
        ):
            self._rows.of[job].queue, self._rows.of[job].place = QUEUE, place

    def settle(self, owner: str) -> None:
        queue = self.queue_of(owner)
        for row in self._rows.of.values():
            if row.user == owner and row.status == "ENQUEUED":
                row.queue = queue

    def move_finished(self, job: str, place: int) -> None:
        if job in self._rows.of and self._rows.of[job].state.finished:
            self._rows.of[job].place = place

    def put_first(self, owner: str, job: str) -> bool:
        row = self._rows.of.get(job)
        if row is None or row.status != "ENQUEUED":
            return False
        rank = rank_in_front(self._waiting(owner, row.queue), time.time_ns() // 1000)
        row.attributes = {**row.attributes, "first": rank}
        self.order(owner)
        return True

    def order(self, owner: str) -> None:
        jobs = self._waiting(owner, QUEUE)
        places = apart(place for _, place, *_ in jobs)
        for (job, *_), better in zip(in_own_order(jobs), places, strict=True):
            self._rows.of[job].place = better

    def order_newest(self, owner: str, job_id: str, priority: int) -> None:
        jobs = self._waiting(owner, QUEUE)
        mine = self._rows.of[job_id].place if job_id in self._rows.of else None
        if any(
            other > priority or first is not None or (place == mine and job != job_id)
            for job, place, other, first in jobs
        ):
            self.order(owner)

    def _waiting(self, owner: str, queue: str | None) -> list[tuple[Any, ...]]:
        rows = [
            row
            for row in self._rows.of.values()
            if row.user == owner and row.queue == queue and row.status == "ENQUEUED"
        ]
        rows.sort(key=lambda row: (row.created_at, row.id))
        return [
            (row.id, row.place, row.attributes["priority"], row.attributes.get("first"))
            for row in rows
        ]


@dataclass
class Folder:
    """What a job has left."""

    frames: int = 0
    told: list[int] = field(default_factory=list)
    marks: set[str] = field(default_factory=set)


class MemoryStorage:
    """Folders of jobs, as far as the queue and histories go."""

    def __init__(self) -> None:
        self._folders: dict[str, Folder] = {}
        self._numbers = itertools.count()

    def make(self, job: str) -> Folder:
        return self._folders.setdefault(job, Folder())

    def mark_for_discard(self, job: str) -> str:
        mark = str(next(self._numbers))
        self.make(job).marks.add(mark)
        return mark

    def unmark(self, job: str, mark: str | None = None) -> None:
        if job in self._folders:
            marks = self._folders[job].marks
            marks.clear() if mark is None else marks.discard(mark)

    def discard_if_marked(self, job: str, *, wait_seconds: float) -> None:
        if job in self._folders and self._folders[job].marks:
            self._folders[job] = Folder()

    def remove_job(self, job: str) -> None:
        self._folders.pop(job, None)


class MemoryQueue(JobQueue):
    """`JobQueue` above rows in memory."""

    def __init__(self, storage: MemoryStorage) -> None:
        self.rows = Rows()
        self._client: Any = self.rows
        self._own: Any = MemoryOwnQueue(self.rows)
        self._storage: Any = storage
        self._cache = {}

    def wake_workers(self) -> None:
        pass

    def delete_finished(self, job: JobRecord) -> bool:
        row = self.rows.of.get(job.id)
        if row is None or not row.state.finished:
            return False
        del self.rows.of[job.id]
        return True

    def close(self) -> None:
        pass

    def get(self, job_id: str) -> JobRecord | None:
        row = self.rows.of.get(job_id)
        if row is None:
            return None
        state = row.state
        return JobRecord(
            id=row.id,
            owner=row.attributes["owner"],
            state=state,
            spec=None,  # type: ignore[arg-type]
            name="",
            sweep=None,
            priority=row.attributes["priority"],
            paused=state is JobState.QUEUED and row.queue == PAUSED_QUEUE,
            estimate=0,
            via_names=[],
            placement=None,
            reused_from=None,
            attributes=row.attributes,
            created_at=datetime.fromtimestamp(row.created_at / 1000, timezone.utc),
            started_at=None,
            finished_at=None,
            executor=row.executor,
            outcome=row.output if state is JobState.SUCCEEDED else None,
            problem=None,
        )

    def states(self, job_ids: Collection[str]) -> dict[str, JobState]:
        return {job: self.rows.of[job].state for job in job_ids if job in self.rows.of}

    def counts(self, owner: str | None = None) -> dict[JobState, int]:
        counts = dict.fromkeys(JobState, 0)
        for row in self.rows.of.values():
            counts[row.state] += 1
        return counts

    def running(self) -> dict[str, set[str]]:
        jobs: dict[str, set[str]] = {}
        for row in self.rows.of.values():
            if row.runs:
                jobs.setdefault(row.executor or "", set()).add(row.id)
        return jobs

    def position(self, job_id: str) -> int | None:
        found = self.rows.of.get(job_id)
        if found is None or not found.waits:
            return None
        mine = found.place, found.created_at
        return sum(
            row.waits and (row.place, row.created_at) < mine for row in self.rows.of.values()
        )

    def _next_place(self, owner: str) -> int:
        rows = self.rows.of.values()
        user = owner or "-"
        return next_place(
            max((r.place for r in rows if r.user == user and (r.runs or r.waits)), default=None),
            max((r.place for r in rows if r.runs), default=None),
            min((r.place for r in rows if r.waits), default=None),
        )


def _now() -> int:
    return int(time.time() * 1000)
