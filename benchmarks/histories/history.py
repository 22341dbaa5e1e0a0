"""A history: what owners, two worker slots and the janitor do, in an order drawn by chance.

Only engines, processes, the polling around them and the clock are played. Calls alternate whole:
nothing is interrupted within a transaction.
"""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from typing import Any
from unittest.mock import patch

from benchmarks.histories.grounds import Ground, forget, try_lock
from chamfer_morph.schemas import BuiltInShape, JobState, Outcome
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker import janitor
from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_state import allowed
from chamfer_morph.worker.queue import JobChangedError
from morph_engine.presets import configure

OWNERS = ("ann", "bob")
SLOTS = ("slot0", "slot1")
STEPS = 14
ACTIONS = (
    "submit", "submit", "claim", "claim", "claim", "compute", "publish", "publish", "fail", "crash",
    "lose_lock", "adopt", "cancel", "resume", "retry", "pause", "unpause", "put_first", "delete",
    "jump",
)  # fmt: skip

BEGIN = 1_900_000_000.0
"""The time at which every history begins [s since 1970]."""

JUMP_SECONDS = 3600


class Violation(AssertionError):
    """A rule that every history must keep is broken."""


class Clock:
    """A clock that histories move; in units of 1/8 s, which are whole milliseconds and exact."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Set it to the time at which histories begin."""
        self._now = BEGIN

    def time(self) -> float:
        """The time [s since 1970]."""
        return self._now

    def time_ns(self) -> int:
        """The same [ns]."""
        return int(self._now * 1e9)

    def move(self, units: int) -> None:
        """Go on, or back, so many units."""
        self._now += units / 8

    @contextmanager
    def everywhere(self) -> Iterator[None]:
        """Let all code of this process, and SQLite, read it."""
        with patch("time.time", self.time), patch("time.time_ns", self.time_ns):
            yield


class Run:
    """A worker's turn at a job: by which token it owns it, and whether it may be taken away."""

    def __init__(self, job: str, slot: str) -> None:
        self.job = job
        self.slot = slot
        self.token = new_id()
        self.replaceable = False


class World:
    """Owners, two worker slots and a janitor around one queue.

    Args:
        ground: The queue and what workers do to it.
        real_clock: Let the clock be that of the machine, as Postgres does.

    Attributes:
        on_clock: In its context code reads the clock of the history.
        chance: What is drawn, is drawn from this.
        seen: What was seen after each step.
    """

    def __init__(self, ground: Ground, *, real_clock: bool = False) -> None:
        self.ground = ground
        self.queue = ground.queue
        self._clock = Clock()
        self.on_clock = nullcontext if real_clock else self._clock.everywhere
        self._spec = JobSpec(
            source=BuiltInShape(shape="sphere"),
            target=BuiltInShape(shape="star"),
            config=configure("fast"),
            timeout_seconds=86400,
        )

    def close(self) -> None:
        """Give everything back."""
        self.ground.close()

    def play(self, number: int) -> list[Any]:
        """Play a history.

        Returns:
            What was seen after each step, which is the same on every ground.

        Raises:
            Violation: A rule is broken; the message says which, and what was done until then.
        """
        with self.on_clock():
            self.begin(number)
            try:
                for _ in range(STEPS):
                    self.step(self.chance.choice(ACTIONS))
                self.finish()
            except Violation as violation:
                raise Violation(f"history {number}: {violation}; {', '.join(self._done)}") from None
            finally:
                self.clear()
        return self.seen

    def begin(self, number: int) -> None:
        """Start a history without jobs."""
        self._clock.begin()
        self._number, self._count = number, itertools.count()
        self.chance = random.Random(number)
        self._jobs: list[str] = []
        self._owners: dict[str, str] = {}
        self._fresh: set[str] = set()  # to be computed from the beginning
        self._frames: Counter[str] = Counter()  # computed since it was to begin from the beginning
        self._outcomes: dict[str, str] = {}  # token of the run whose outcome stands
        self._last_token: dict[str, str] = {}  # of the run that each job was given to last
        self._runs: dict[str, Run | None] = dict.fromkeys(SLOTS)
        self._ghosts: list[Run] = []  # of workers that have lost their lock and do not know it
        self._locks = {slot: self._lock(slot) for slot in SLOTS}
        self._done: list[str] = []
        self.seen: list[Any] = []
        self._queued_at: dict[str, tuple[int, float]] = {}  # step and time at which it was queued
        self._alone_since: dict[str, int] = {}  # the step since which it waits as its owner's only
        self._passed: dict[str, set[str]] = {}  # later jobs of others that went before it

    def step(self, action: str) -> None:
        """Do one thing, and see that the rules are kept."""
        self._done.append(action)
        self._clock.move(self.chance.randint(1, 16))
        before = self.queue.states(self._jobs)
        touched = getattr(self, f"_{action}")()
        after = self.queue.states(self._jobs)
        if set(after) != set(self._jobs):
            raise Violation("a job is lost")
        for job, state in before.items():
            if state.finished and job in after and after[job] is not state and job != touched:
                raise Violation(f"{job} was {state.value} and is {after[job].value}")
        self.seen.append((action, touched, [after[job].value for job in self._jobs]))
        self._note_turns(after)

    def _now(self) -> tuple[int, float]:
        """Number of this step, and the time."""
        return len(self._done), self._clock.time()

    def _note_turns(self, states: Mapping[str, JobState]) -> None:
        """Keep which queued jobs are the only ones of their owners that are not finished."""
        unfinished = [job for job in self._jobs if not states[job].finished]
        owners = Counter(self._owners[job] for job in unfinished)
        for job in self._jobs:
            if states[job] is JobState.QUEUED and owners[self._owners[job]] == 1:
                self._alone_since.setdefault(job, len(self._done))
            else:
                self._alone_since.pop(job, None)
                self._passed[job] = set()

    def _check_turn(self, started: str, waiting: Collection[str]) -> None:
        """Whoever has one job waits at most for one that another owner has queued later."""
        for job in waiting:
            since = self._alone_since.get(job)
            if since is None:
                continue
            step, at = self._queued_at[started]
            later = step > since and at > self._queued_at[job][1]  # the clock may be set back
            if later and self._owners[job] != self._owners[started]:
                self._passed.setdefault(job, set()).add(started)
                if len(self._passed[job]) > 1:
                    raise Violation("two jobs that were queued later go before an owner's only one")

    def _submit(self) -> None:
        job = f"history{self._number:08d}job{next(self._count):02d}"
        priority = self.chance.choice((50, 100))
        owner = self._owners[job] = self.chance.choice(OWNERS)
        self.queue.enqueue(self._spec, job_id=job, owner=owner, priority=priority)
        self._jobs.append(job)
        self._queued_at[job] = self._now()

    def _claim(self) -> None:
        slot = self.chance.choice(SLOTS)
        if self._runs[slot] is not None or self._locks[slot] is None:
            return
        run = Run("", slot)
        waiting = [r for job in self._jobs if (r := self.queue.get(job)) and self._waits(r)]
        claimed = self.ground.claim(slot, run.token)
        if bool(claimed) != bool(waiting):
            raise Violation(f"{len(claimed)} of {len(waiting)} waiting jobs are started")
        if not claimed:
            return
        (run.job,) = claimed
        if run.job not in {record.id for record in waiting}:
            raise Violation("a job is started that waits not, or whose owner has paused")
        self._check_turn(run.job, [record.id for record in waiting])
        holders = [r for r in self._runs.values() if r and r.job == run.job and not r.replaceable]
        if holders:
            raise Violation("a job is given to a second worker while the first lives")
        self._runs[slot], self._last_token[run.job] = run, run.token
        self.seen.append(run.job)
        frames = self.ground.begin(run.job)
        if run.job in self._fresh:
            self._fresh.discard(run.job)
            self._frames[run.job] = 0
        if frames > self._frames[run.job]:
            raise Violation("a retried job begins with frames of before")
        if frames < self._frames[run.job]:
            raise Violation("more is computed again than the frame that was under way")
        self._check_events(run.job)

    def _compute(self) -> None:
        for run in self._holders():
            if self.ground.owns(run.job, run.token):
                self._save_frame(run.job)
                self.ground.tell(run.job)
                self._check_events(run.job)
            else:
                self._leave(run)

    def _save_frame(self, job: str) -> None:
        self.ground.save_frame(job)
        self._frames[job] += 1

    def _check_events(self, job: str) -> None:
        """Each frame is told of once, in their order."""
        if self.ground.events(job) != [*range(self._frames[job])]:
            raise Violation("events do not tell of each frame once, in their order")

    def _publish(self) -> str | None:
        return self._end("SUCCESS")

    def _fail(self) -> str | None:
        return self._end("ERROR")

    def _end(self, status: str) -> str | None:
        if not (holders := self._holders()):
            return None
        run = self.chance.choice(holders)
        outcome = Outcome(
            sha256=run.token.encode().hex().ljust(64, "0")[:64], size_bytes=1, frames=1, metrics={},
            particle_count=1, target_count=1, cpu_seconds=0, peak_memory_mb=0,
        )  # fmt: skip
        written = self.ground.write_outcome(run.job, status, outcome, run.token)
        if written and self._last_token[run.job] != run.token:
            raise Violation("a worker that lost its job has written its outcome")
        self._leave(run)
        record = self.queue.get(run.job)
        if written and status == "SUCCESS":
            self._outcomes[run.job] = outcome.sha256
        if record and record.state is JobState.SUCCEEDED and record.outcome:
            if record.outcome.sha256 != self._outcomes.get(run.job):
                raise Violation("an outcome has been overwritten")
        return None

    def _crash(self) -> None:
        """Within a frame, which is lost, or after it and before anybody is told of it."""
        slot = self.chance.choice(SLOTS)
        run, saved = self._runs[slot], self.chance.choice((False, True))
        if saved and run is not None and self.ground.owns(run.job, run.token):
            self._save_frame(run.job)
        self._end_slot(slot)

    def _lose_lock(self) -> None:
        """As Postgres takes it from a worker that has been silent; the worker does not know."""
        slot = self.chance.choice(SLOTS)
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
        janitor.adopt_orphans(self.ground.settings, self.queue, self.ground.queue_again)
        for slot in SLOTS:
            if self._locks[slot] is None and slot not in self.queue.running():
                self._locks[slot] = self._lock(slot)

    def _lock(self, slot: str) -> Any:
        return try_lock(self.ground, slot)

    def _cancel(self) -> str | None:
        if job := self._pick("cancel"):
            self.queue.cancel(job)
            self._let_go(job)
        return job

    def _resume(self) -> str | None:
        if job := self._pick("resume"):
            self.queue.resume(job)
            self._queued_at[job] = self._now()
            self._let_go(job)
        return job

    def _retry(self) -> str | None:
        if job := self._pick("retry"):
            self.queue.retry(job)
            self._fresh.add(job)
            self._queued_at[job] = self._now()
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
            record = self.queue.get(job)
            if record is None or not self.queue.delete_finished(record):
                raise Violation("a finished job cannot be deleted")
            self.ground.remove(job)
        return job

    def _jump(self) -> None:
        """The clock is set, by up to an hour forward or back."""
        self._clock.move(self.chance.randint(-JUMP_SECONDS, JUMP_SECONDS) * 8)

    def _pause(self) -> None:
        self.queue.pause(self.chance.choice(OWNERS))

    def _unpause(self) -> None:
        self._end_pause(self.chance.choice(OWNERS))

    def _end_pause(self, owner: str) -> None:
        """Jobs of this owner take places as if they were queued now."""
        self.queue.unpause(owner)
        for job in self._jobs:
            if self._owners[job] == owner:
                self._queued_at[job] = self._now()
                self._passed.pop(job, None)
                self._alone_since.pop(job, None)

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

    def finish(self) -> None:
        """Let everything end; every job must."""
        for owner in OWNERS:
            self._end_pause(owner)
        for _ in range(8 * len(self._jobs) + 8):
            if all(state.finished for state in self.queue.states(self._jobs).values()):
                break
            self.step("adopt")
            self.step("claim")
            self.step("publish")
        states = Counter(self.queue.states(self._jobs).values())
        if any(not state.finished for state in states):
            raise Violation(f"jobs never end: {dict(states)}")
        if {s: n for s, n in self.queue.counts().items() if n} != dict(states):
            raise Violation("counts are not the sums of jobs")

    def _pick(self, action: Any) -> str | None:
        states = self.queue.states(self._jobs)
        found = [job for job in self._jobs if allowed(states[job], action)]
        return self.chance.choice(found) if found else None

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

    def clear(self) -> None:
        for slot in SLOTS:
            self._end_slot(slot)
        for owner in OWNERS:
            self.queue.unpause(owner)
        for job in self._jobs:
            forget(self.ground, job)
