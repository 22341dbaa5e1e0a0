"""Event streams: one task polls every job that is followed, however many follow it.

It asks the database for all their states at once and reads what their logs have grown by. An event
is encoded once, for all subscribers of that job.
"""

from __future__ import annotations

import asyncio
import logging
import os
from bisect import bisect_right
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import datetime, timezone

import anyio
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event

from chamfer_morph.schemas import Event, JobState
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.event_log import EventLog
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.storage import Storage

POLL_SECONDS = 0.15
KEEP_ALIVE_SECONDS = 15.0
RECONNECT_MILLISECONDS = 1000
BATCH = 256
"""Events sent at once to who comes late."""

_LOG = logging.getLogger(__name__)


class JobFeed:
    """The events of one job.

    Attributes:
        state: Its state, None before the first poll and once it is gone.
        subscribers: How many streams send it.
        ready: Set once it has been read.
    """

    def __init__(self, log: EventLog) -> None:
        self.state: JobState | None = None
        self.subscribers = 0
        self.ready: asyncio.Event = asyncio.Event()
        self._changed = asyncio.Event()
        self._log = log
        self._size = 0
        self._ids: list[int] = []
        self._encoded: list[bytes] = []
        self._next: tuple[JobState | None, list[int], list[bytes], bool] | None = None

    def read(self, state: JobState | None) -> None:
        """Read what is new; the state was asked for before, so a final one has all its events."""
        try:
            size = os.stat(self._log.path).st_size
        except FileNotFoundError:
            size = 0
        restarted = size < self._size  # the job began anew
        ids: list[int] = []
        encoded: list[bytes] = []
        if size != self._size:
            after = self._ids[-1] if self._ids and not restarted else 0
            for event in self._log.read(after, limit=1 << 30):
                ids.append(event.id)
                encoded.append(encode_event(event))
        if ids or restarted or state is not self.state or not self.ready.is_set():
            self._next = state, ids, encoded, restarted
        self._size = size

    def publish(self) -> None:
        """Let the subscribers see what the last read has found."""
        if self._next is None:
            return
        state, ids, encoded, restarted = self._next
        self._next = None
        if restarted:
            self._ids.clear()
            self._encoded.clear()
        self._ids += ids
        self._encoded += encoded
        self.state = state
        self.ready.set()
        self.wake()

    def wake(self) -> None:
        """Wake the subscribers."""
        self._changed.set()
        self._changed = asyncio.Event()

    async def events(self, after: int, closing: asyncio.Event) -> AsyncIterator[bytes]:
        """Encoded events after an id, until the job rests, and its states as they change."""
        await self.ready.wait()
        yield f"retry: {RECONNECT_MILLISECONDS}\n\n".encode()
        sent_state: JobState | None = None
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
            if state is not sent_state:
                sent_state = state
                yield encode_event(state_event(after, state))
            if state.finished:
                return
            try:
                with anyio.fail_after(KEEP_ALIVE_SECONDS):
                    await changed.wait()
            except TimeoutError:
                yield KEEPALIVE_COMMENT


class EventHub:
    """All event streams."""

    def __init__(self, queue: JobQueue, storage: Storage, limit: int) -> None:
        self._queue = queue
        self._storage = storage
        self._limit = limit
        self._feeds: dict[str, JobFeed] = {}
        self._task: asyncio.Task[None] | None = None
        self._thread = anyio.CapacityLimiter(1)
        self.closing: asyncio.Event = asyncio.Event()

    @property
    def subscribers(self) -> int:
        """Subscribers at this moment."""
        return sum(feed.subscribers for feed in self._feeds.values())

    def check_capacity(self) -> None:
        """Refuse one subscriber too many.

        Raises:
            ProblemError: 429.
        """
        if self.subscribers >= self._limit:
            raise ProblemError(
                429,
                f"{self._limit} event streams are open already.",
                "Ask for the events without Accept: text/event-stream, every few seconds.",
                headers={"Retry-After": "10"},
            )

    async def stream(self, job_id: str, after: int) -> AsyncIterator[bytes]:
        """The events of a job as server-sent events, until it rests."""
        async with self._subscribed(job_id) as feed:
            async for encoded in feed.events(after, self.closing):
                yield encoded

    def close(self) -> None:
        """End all streams; a subscriber reconnects to the next process."""
        self.closing.set()
        for feed in self._feeds.values():
            feed.ready.set()
            feed.wake()

    @asynccontextmanager
    async def _subscribed(self, job_id: str) -> AsyncIterator[JobFeed]:
        feed = self._feeds.setdefault(job_id, JobFeed(self._storage.events(job_id)))
        feed.subscribers += 1
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._poll())
        try:
            yield feed
        finally:
            feed.subscribers -= 1
            if not feed.subscribers:
                self._feeds.pop(job_id, None)

    async def _poll(self) -> None:
        while self._feeds and not self.closing.is_set():
            feeds = dict(self._feeds)
            try:
                await anyio.to_thread.run_sync(self._read_all, feeds, limiter=self._thread)
            except Exception:
                _LOG.warning("events cannot be read now", exc_info=True)
                await asyncio.sleep(1)
            for feed in feeds.values():
                feed.publish()
            await asyncio.sleep(POLL_SECONDS)

    def _read_all(self, feeds: dict[str, JobFeed]) -> None:
        states = self._queue.states(feeds)
        for job_id, feed in feeds.items():
            feed.read(states.get(job_id))


def encode_event(event: Event) -> bytes:
    """An event as a server-sent event."""
    return format_sse_event(data_str=event.model_dump_json(), event=event.type, id=str(event.id))


def state_event(after: int, state: JobState) -> Event:
    """A change of state; it has the id of the last event before it."""
    return Event(id=after, type="state", at=datetime.now(timezone.utc), data={"state": state.value})
