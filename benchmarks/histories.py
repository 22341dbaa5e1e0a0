"""Seeded histories of jobs: what owners, workers and the janitor do, in an order drawn by chance.

    python -m benchmarks.histories --count 10000 --first 0

The queue, its database (SQLite), job folders and locks are the real ones, as are the statements by
which DBOS claims a job, queues it again and records its outcome. Only engines, processes and the
polling around them are played. Calls alternate whole: nothing is interrupted within a transaction.
A history that breaks a rule is named by its number, and `--first NUMBER --count 1` repeats it.
"""

from __future__ import annotations

import argparse
import itertools
import random
import sys
import tempfile
import time
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from dbos import error as dbos_error

from chamfer_morph.schemas import BuiltInShape, JobState, Outcome
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker import janitor, locks
from chamfer_morph.worker.dbos_adapter import SERIALIZER
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_state import allowed
from chamfer_morph.worker.own_queue import QUEUE
from chamfer_morph.worker.queue import APPLICATION_VERSION, JobChangedError, JobQueue
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage
from morph_engine.presets import configure

OWNERS = ("ann", "bob")
SLOTS = ("slot0", "slot1")
STEPS = 14
ACTIONS = (
    "submit", "submit", "claim", "claim", "claim", "compute", "publish", "publish", "fail", "crash",
    "lose_lock", "adopt", "cancel", "resume", "retry", "pause", "unpause", "put_first", "delete",
)  # fmt: skip


class Violation(AssertionError):
    """A rule that every history must keep is broken."""


class Run:
    """A worker's turn at a job: by which token it owns it, and whether it may be taken away."""

    def __init__(self, job: str, slot: str) -> None:
        self.job = job
        self.slot = slot
        self.token = new_id()
        self.replaceable = False


class World:
    """Owners, two worker slots and a janitor around one real queue."""

    def __init__(self, folder: Path) -> None:
        self.settings = Settings(_env_file=None, data_dir=folder)
        self.queue = JobQueue(self.settings)
        self.queue.migrate()
        self.storage = Storage(folder)
        self._dbos: Any = self.queue._client._sys_db
        self._lane = self.queue._client.retrieve_queue(QUEUE)
        self._spec = JobSpec(
            source=BuiltInShape(shape="sphere"),
            target=BuiltInShape(shape="star"),
            config=configure("fast"),
            timeout_seconds=86400,
        )

    def close(self) -> None:
        """Give the connections back."""
        self.queue.close()

    def play(self, number: int) -> None:
        """Play a history.

        Raises:
            Violation: A rule is broken; the message says which, and what was done until then.
        """
        self._number, self._count = number, itertools.count()
        self._chance = random.Random(number)
        self._jobs: list[str] = []
        self._fresh: set[str] = set()  # to be computed from the beginning
        self._outcomes: dict[str, str] = {}  # token of the run whose outcome stands
        self._runs: dict[str, Run | None] = dict.fromkeys(SLOTS)
        self._ghosts: list[Run] = []  # of workers that have lost their lock and do not know it
        self._locks = {slot: self._lock(slot) for slot in SLOTS}
        self._done: list[str] = []
        try:
            for _ in range(STEPS):
                self._step(self._chance.choice(ACTIONS))
            self._finish()
        except Violation as violation:
            raise Violation(f"history {number}: {violation}; {', '.join(self._done)}") from None
        finally:
            self._clear()

    def _step(self, action: str) -> None:
        self._done.append(action)
        before = self.queue.states(self._jobs)
        touched = getattr(self, f"_{action}")()
        after = self.queue.states(self._jobs)
        if set(after) != set(self._jobs):
            raise Violation("a job is lost")
        for job, state in before.items():
            if state.finished and job in after and after[job] is not state and job != touched:
                raise Violation(f"{job} was {state.value} and is {after[job].value}")

    def _submit(self) -> None:
        job = f"history{self._number:08d}job{next(self._count):02d}"  # the same at each repetition
        priority = self._chance.choice((50, 100))
        self.queue.enqueue(
            self._spec, job_id=job, owner=self._chance.choice(OWNERS), priority=priority
        )
        self._jobs.append(job)

    def _claim(self) -> None:
        slot = self._chance.choice(SLOTS)
        if self._runs[slot] is not None or self._locks[slot] is None:
            return
        run = Run("", slot)
        waiting = [r for job in self._jobs if (r := self.queue.get(job)) and self._waits(r)]
        claimed, _ = self._dbos.start_queued_workflows(
            self._lane, slot, APPLICATION_VERSION, None, owner_xid=run.token
        )
        if bool(claimed) != bool(waiting):
            raise Violation(f"{len(claimed)} of {len(waiting)} waiting jobs are started")
        if not claimed:
            return
        (run.job,) = claimed
        if run.job not in {record.id for record in waiting}:
            raise Violation("a job is started that waits not, or whose owner has paused")
        holders = [r for r in self._runs.values() if r and r.job == run.job and not r.replaceable]
        if holders:
            raise Violation("a job is given to a second worker while the first lives")
        self._runs[slot] = run
        self.storage.discard_if_marked(run.job, wait_seconds=0)
        folder = self.storage.job_dir(run.job)
        folder.mkdir(exist_ok=True)
        if run.job in self._fresh and (folder / "frames").exists():
            raise Violation("a retried job begins with frames of before")
        self._fresh.discard(run.job)

    def _compute(self) -> None:
        for run in self._holders():
            try:
                with self._dbos.engine.begin() as connection:
                    self._dbos._check_owner_txn(connection, run.job, run.token)
            except dbos_error.DBOSWorkflowConflictIDError:
                self._leave(run)
            else:
                with suppress(FileNotFoundError):
                    (self.storage.job_dir(run.job) / "frames").touch()

    def _publish(self) -> str | None:
        return self._end("SUCCESS")

    def _fail(self) -> str | None:
        return self._end("ERROR")

    def _end(self, status: str) -> str | None:
        if not (holders := self._holders()):
            return None
        run = self._chance.choice(holders)
        outcome = Outcome(
            sha256=run.token.encode().hex().ljust(64, "0")[:64], size_bytes=1, frames=1, metrics={},
            particle_count=1, target_count=1, cpu_seconds=0, peak_memory_mb=0,
        )  # fmt: skip
        written = self._dbos.update_workflow_outcome(
            run.job,
            status,
            output=SERIALIZER.serialize(outcome.model_dump(mode="json")),
            owner_xid=run.token,
        )
        if written and (run.replaceable and self._given_on(run)):
            raise Violation("a worker that lost its job has written its outcome")
        self._leave(run)
        record = self.queue.get(run.job)
        if written and status == "SUCCESS":
            self._outcomes[run.job] = outcome.sha256
        if record and record.state is JobState.SUCCEEDED and record.outcome:
            if record.outcome.sha256 != self._outcomes.get(run.job):
                raise Violation("an outcome has been overwritten")
        return None

    def _given_on(self, run: Run) -> bool:
        """Whether the job of a run has been claimed by another since."""
        others = [*self._runs.values(), *self._ghosts]
        return any(r is not run and r and r.job == run.job for r in others)

    def _crash(self) -> None:
        self._end_slot(self._chance.choice(SLOTS))

    def _lose_lock(self) -> None:
        """As Postgres takes it from a worker that has been silent; the worker does not know."""
        slot = self._chance.choice(SLOTS)
        if (run := self._runs[slot]) is not None:
            run.replaceable = True
            self._ghosts.append(run)
        self._end_slot(slot)

    def _end_slot(self, slot: str) -> None:
        if (lock := self._locks[slot]) is not None:
            lock.release()
        self._locks[slot] = self._runs[slot] = None

    def _adopt(self) -> None:
        """What the janitor does, and then the start of slots that are gone."""
        janitor.adopt_orphans(self.settings, self.queue, self._queue_again)
        for slot in SLOTS:
            if self._locks[slot] is None and slot not in self.queue.running():
                self._locks[slot] = self._lock(slot)

    def _queue_again(self, slot: str) -> None:
        """What a DBOS process of this name does at its start."""
        for pending in self._dbos.get_pending_workflows(slot, APPLICATION_VERSION):
            self._dbos.reenqueue_for_recovery(pending.workflow_id, [slot], QUEUE)

    def _lock(self, slot: str) -> Any:
        return locks.try_lock(self.settings, slot)

    def _cancel(self) -> str | None:
        if job := self._pick("cancel"):
            self.queue.cancel(job)
            self._let_go(job)
        return job

    def _resume(self) -> str | None:
        if job := self._pick("resume"):
            self.queue.resume(job)
            self._let_go(job)
        return job

    def _retry(self) -> str | None:
        if job := self._pick("retry"):
            self.queue.retry(job)
            self._fresh.add(job)
            self._let_go(job)
        else:
            for busy in self._jobs[:1]:  # refused, and without a trace
                with suppress(JobChangedError):
                    if not self.queue.states([busy])[busy].finished:
                        self.queue.retry(busy)
                        raise Violation("an unfinished job is retried")
        return job

    def _delete(self) -> str | None:
        if job := self._pick("delete"):
            self._jobs.remove(job)
            self._let_go(job)
            self.queue.delete(job)
            self.storage.remove_job(job)
        return job

    def _pause(self) -> None:
        self.queue.pause(self._chance.choice(OWNERS))

    def _unpause(self) -> None:
        self.queue.unpause(self._chance.choice(OWNERS))

    def _put_first(self) -> None:
        if (job := self._pick("next")) and not self.queue.get(job).paused:  # type: ignore[union-attr]
            owner = self.queue.get(job).owner  # type: ignore[union-attr]
            self.queue.put_first(job)
            place = self.queue.position(job)
            for other in self._jobs:
                record = self.queue.get(other)
                if other != job and record and record.owner == owner and self._waits(record):
                    if self.queue.position(other) < place:  # type: ignore[operator]
                        raise Violation("the job put first is not the first of its owner")

    def _finish(self) -> None:
        """Let everything end; every job must."""
        for owner in OWNERS:
            self.queue.unpause(owner)
        for _ in range(8 * len(self._jobs) + 8):
            if all(state.finished for state in self.queue.states(self._jobs).values()):
                break
            self._step("adopt")
            self._step("claim")
            self._step("publish")
        states = Counter(self.queue.states(self._jobs).values())
        if any(not state.finished for state in states):
            raise Violation(f"jobs never end: {dict(states)}")
        if {s: n for s, n in self.queue.counts().items() if n} != dict(states):
            raise Violation("counts are not the sums of jobs")

    def _pick(self, action: Any) -> str | None:
        states = self.queue.states(self._jobs)
        found = [job for job in self._jobs if allowed(states[job], action)]
        return self._chance.choice(found) if found else None

    def _holders(self) -> list[Run]:
        return [*(run for run in self._runs.values() if run), *self._ghosts]

    def _let_go(self, job: str) -> None:
        for run in self._holders():
            if run.job == job:
                run.replaceable = True

    def _leave(self, run: Run) -> None:
        if run in self._ghosts:
            self._ghosts.remove(run)
        elif self._runs[run.slot] is run:
            self._runs[run.slot] = None

    @staticmethod
    def _waits(record: Any) -> bool:
        return record.state is JobState.QUEUED and not record.paused

    def _clear(self) -> None:
        for slot in SLOTS:
            self._end_slot(slot)
        for owner in OWNERS:
            self.queue.unpause(owner)
        for job in self._jobs:
            self.queue.delete(job)
            self.storage.remove_job(job)


def main() -> int:
    """Play histories and print what came of it; returns the number that broke a rule."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.histories", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first history")
    options = parser.parse_args()
    broken, cpu = 0, time.process_time()
    with tempfile.TemporaryDirectory() as name, closing(World(Path(name))) as world:
        for number in range(options.first, options.first + options.count):
            try:
                world.play(number)
            except Violation as violation:
                broken += 1
                print(violation)
    each = (time.process_time() - cpu) / options.count * 1e3
    print(f"{options.count} histories, {each:.1f} ms of CPU time each, {broken} broke a rule")
    return min(broken, 1)


if __name__ == "__main__":
    sys.exit(main())
