"""Watched jobs: one task looks after all of them, however many watch.

It asks the database for all their states at once and reads what their logs have grown by. An event
is encoded once, for all who watch that job.
"""

from __future__ import annotations

import asyncio
import logging
import os
from bisect import bisect_right
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event

from chamfer_morph.schemas import Event, JobState
from chamfer_morph.server.database.tables import as_time, now
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.event_log import EventLog
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.storage import Storage

LOOK_SECONDS = 0.15
KEEP_ALIVE_SECONDS = 15.0
RECONNECT_MILLISECONDS = 1000
BATCH = 256
"""Events sent at once to who comes late."""

_LOG = logging.getLogger(__name__)


class Watch:
    """A watched job.

    Attributes:
        state: Its state, None before the first look and once it is gone.
        watchers: How many watch it.
        ready: Set once it has been looked at.
    """

    def __init__(self, log: EventLog) -> None:
        self.state: JobState | None = None
        self.watchers = 0
        self.ready = asyncio.Event()
        self._changed = asyncio.Event()
        self._log = log
        self._size = 0
        self._ids: list[int] = []
        self._encoded: list[bytes] = []
        self._next: tuple[JobState | None, list[int], list[bytes], bool] | None = None

    def look(self, state: JobState | None) -> None:
        """Read what is new; the state was asked for before, so a final one has all its events."""
        try:
            size = os.stat(self._log.path).st_size
        except FileNotFoundError:
            size = 0
        again = size < self._size  # the job began anew
        ids: list[int] = []
        encoded: list[bytes] = []
        if size != self._size:
            after = self._ids[-1] if self._ids and not again else 0
            for event in self._log.read(after, limit=1 << 30):
                ids.append(event.id)
                encoded.append(
                    encode(
                        Event.model_validate(
                            {"id": event.id, "type": event.type, "at": event.at, "data": event.data}
                        )
                    )
                )
        if ids or again or state is not self.state or not self.ready.is_set():
            self._next = state, ids, encoded, again
        self._size = size

    def publish(self) -> None:
        """Let the watchers see what the last look has found."""
        if self._next is None:
            return
        state, ids, encoded, again = self._next
        self._next = None
        if again:
            self._ids.clear()
            self._encoded.clear()
        self._ids += ids
        self._encoded += encoded
        self.state = state
        self.ready.set()
        self.wake()

    def wake(self) -> None:
        """Let the watchers look."""
        self._changed.set()
        self._changed = asyncio.Event()

    async def events(self, after: int, closing: asyncio.Event) -> AsyncIterator[bytes]:
        """Encoded events after an id, until the job rests, and its states as they change."""
        await self.ready.wait()
        yield f"retry: {RECONNECT_MILLISECONDS}\n\n".encode()
        told: JobState | None = None
        while not closing.is_set():
            changed, state = self._changed, self.state
            last = self._ids[-1] if self._ids else 0
            after = 0 if after > last else after
            begin = bisect_right(self._ids, after)
            if begin < len(self._ids):
                batch = slice(begin, begin + BATCH)
                encoded, after = b"".join(self._encoded[batch]), self._ids[batch][-1]
                yield encoded
                continue
            if state is None:
                return
            if state is not told:
                told = state
                yield encode(state_event(after, state))
            if state.finished:
                return
            try:
                with anyio.fail_after(KEEP_ALIVE_SECONDS):
                    await changed.wait()
            except TimeoutError:
                yield KEEPALIVE_COMMENT


class Watches:
    """All watched jobs.

    Args:
        queue: Knows their states.
        storage: Has their logs.
        limit: Watchers at the same time.
    """

    def __init__(self, queue: JobQueue, storage: Storage, limit: int) -> None:
        self._queue = queue
        self._storage = storage
        self._limit = limit
        self._watches: dict[str, Watch] = {}
        self._task: asyncio.Task[None] | None = None
        self._thread = anyio.CapacityLimiter(1)
        self.closing = asyncio.Event()

    @property
    def watchers(self) -> int:
        """Watchers at this moment."""
        return sum(watch.watchers for watch in self._watches.values())

    def check_room(self) -> None:
        """Refuse one watcher too many.

        Raises:
            ProblemError: 429.
        """
        if self.watchers >= self._limit:
            raise ProblemError(
                429,
                f"{self._limit} event streams are open already.",
                "Ask for the events without Accept: text/event-stream, every few seconds.",
                headers={"Retry-After": "10"},
            )

    async def stream(self, job_id: str, after: int) -> AsyncIterator[bytes]:
        """The events of a job as server-sent events, until it rests."""
        async with self._watching(job_id) as watch:
            async for encoded in watch.events(after, self.closing):
                yield encoded

    def close(self) -> None:
        """End all streams; whoever watches comes back to the next process."""
        self.closing.set()
        for watch in self._watches.values():
            watch.ready.set()
            watch.wake()

    @asynccontextmanager
    async def _watching(self, job_id: str) -> AsyncIterator[Watch]:
        watch = self._watches.setdefault(job_id, Watch(self._storage.events(job_id)))
        watch.watchers += 1
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._look_on())
        try:
            yield watch
        finally:
            watch.watchers -= 1
            if not watch.watchers:
                self._watches.pop(job_id, None)

    async def _look_on(self) -> None:
        while self._watches and not self.closing.is_set():
            watches = dict(self._watches)
            try:
                await anyio.to_thread.run_sync(self._look, watches, limiter=self._thread)
            except Exception:
                _LOG.warning("watched jobs cannot be looked at now", exc_info=True)
                await asyncio.sleep(1)
            for watch in watches.values():
                watch.publish()
            await asyncio.sleep(LOOK_SECONDS)

    def _look(self, watches: dict[str, Watch]) -> None:
        states = self._queue.states(watches)
        for job_id, watch in watches.items():
            watch.look(states.get(job_id))


def encode(event: Event) -> bytes:
    """An event as a server-sent event."""
    return format_sse_event(data_str=event.model_dump_json(), event=event.type, id=str(event.id))


def state_event(after: int, state: JobState) -> Event:
    """A change of state; it has the id of the last event before it."""
    return Event(id=after, type="state", at=as_time(now()), data={"state": state.value})
