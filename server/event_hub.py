"""Event streams: one task polls every job that is followed, however many follow it.

It asks the database for all their states at once and reads what their logs have grown by. An event
is encoded once, for all subscribers of that job.
"""

from __future__ import annotations

import asyncio
import logging
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from dataclasses import dataclass
from datetime import datetime, timezone
from operator import itemgetter

import anyio
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event

from chamfer_morph.schemas import Event, JobState
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.event_log import EventLog
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.storage import Storage, StoreUnavailableError

LOOK_SECONDS = 0.03
"""How often logs are read on, as far as they are here."""

LOOKS = 5
"""How often they are between two polls of the database, and of an object store."""

KEEP_ALIVE_SECONDS = 15.0
RECONNECT_MILLISECONDS = 1000
CHECK_SECONDS = 1.0
"""How long the key or share link of an open stream is trusted."""

AWAY_SECONDS = 15.0
"""How long an object store that has not answered is not asked again, which may take long."""

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
        self._has_news = False
        self._events: list[tuple[int, bytes]] = []

    def read(self, state: JobState | None) -> None:
        """Read what is new; the state was asked for before, so a final one has all its events."""
        size = self._log.version()[1]
        if size != self._size or state is not self.state or not self.ready.is_set():
            self._has_news = True
        if size != self._size:
            known = self._events if size > self._size else []  # a shorter log has begun anew
            new = self._log.read(known[-1][0] if known else 0, limit=1 << 30)
            self._events = known + [(event.id, encode_event(event)) for event in new]
        self._size, self.state = size, state

    def publish(self) -> None:
        """Let the subscribers see what the last read has found."""
        if self._has_news:
            self._has_news = False
            self.wake()

    def wake(self) -> None:
        """Wake the subscribers."""
        self.ready.set()
        self._changed.set()
        self._changed = asyncio.Event()

    async def events(self, after: int, is_open: Callable[[], bool]) -> AsyncIterator[bytes]:
        """Encoded events after an id, until the job rests, and its states as they change.

        Args:
            after: The id.
            is_open: Whether to go on.
        """
        await self.ready.wait()
        yield f"retry: {RECONNECT_MILLISECONDS}\n\n".encode()
        sent_state: JobState | None = None
        while is_open():
            # the state before the events, for a thread may write the events and then the state
            changed, state, events = self._changed, self.state, self._events
            after = 0 if not events or after > events[-1][0] else after
            begin = bisect_right(events, after, key=itemgetter(0))
            if batch := events[begin : begin + BATCH]:
                yield b"".join(encoded for _, encoded in batch)
                after = batch[-1][0]
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


@dataclass(frozen=True, eq=False)
class Subscription:
    """A place among the event streams, taken until it is given back.

    Attributes:
        hub: Whose place it is.
        job_id: The job that is followed.
        caller: Who follows it.
        key: Name of the key whose place it is: for a share link that of the owner of the job.
        feed: What happens to the job.
    """

    hub: EventHub
    job_id: str
    caller: Caller
    key: str
    feed: JobFeed

    def events(self, after: int) -> AsyncIterator[bytes]:
        """Events after an id as server-sent events, until the job rests or the key is revoked."""
        return self.feed.events(after, lambda: self.hub.is_open(self))


class EventHub:
    """All event streams.

    Args:
        queue: Knows the states of jobs.
        storage: Has their logs.
        still_valid: Which of some callers have a key or share link that has not been revoked.
        limit: Most streams at the same time.
        limit_per_key: Most of one key among them.
    """

    def __init__(
        self,
        queue: JobQueue,
        storage: Storage,
        still_valid: Callable[[Collection[Caller]], Awaitable[Collection[Caller]]],
        limit: int,
        limit_per_key: int,
    ) -> None:
        self._queue = queue
        self._storage = storage
        self._still_valid = still_valid
        self._limit = limit
        self._limit_per_key = limit_per_key
        self._open: set[Subscription] = set()
        self._of_key: Counter[str] = Counter()
        self._feeds: dict[str, JobFeed] = {}
        self._task: asyncio.Task[None] | None = None
        self._away_until = float("-inf")
        self._unreadable: set[str] = set()  # jobs whose log cannot be read
        self._thread = anyio.CapacityLimiter(1)
        self.closing: asyncio.Event = asyncio.Event()

    @property
    def subscribers(self) -> int:
        """Subscribers at this moment."""
        return sum(feed.subscribers for feed in self._feeds.values())

    def subscribe(self, job: JobRecord, caller: Caller) -> Subscription:
        """Take a place for a stream of a job; a key has its share of them from this moment on.

        Raises:
            ProblemError: 429. There are as many as may be, of all or of the key.
        """
        key = caller.name if caller.shared is None else job.owner
        self._check_capacity(key)
        self._of_key[key] += 1
        feed = self._feeds.setdefault(job.id, JobFeed(self._storage.events(job.id)))
        feed.subscribers += 1
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._poll())
        subscription = Subscription(self, job.id, caller, key, feed)
        self._open.add(subscription)
        return subscription

    def is_open(self, subscription: Subscription) -> bool:
        """Whether a stream may go on: neither it nor the hub has ended."""
        return subscription in self._open and not self.closing.is_set()

    def unsubscribe(self, subscription: Subscription) -> None:
        """Give a place back, and forget the job when it was the last one."""
        self._open.discard(subscription)
        self._of_key[subscription.key] -= 1
        subscription.feed.subscribers -= 1
        if not subscription.feed.subscribers:
            self._feeds.pop(subscription.job_id, None)

    def _check_capacity(self, key: str) -> None:
        if self.subscribers >= self._limit or self._of_key[key] >= self._limit_per_key:
            mine = self.subscribers < self._limit
            raise ProblemError(
                429,
                f"This key already has {self._limit_per_key} open event streams."
                if mine
                else f"{self._limit} event streams are already open.",
                "Poll the events without Accept: text/event-stream, every few seconds.",
                headers={"Retry-After": "10"},
            )

    def close(self) -> None:
        """End all streams; a subscriber reconnects to the next process."""
        self.closing.set()
        for feed in self._feeds.values():
            feed.wake()

    async def _poll(self) -> None:
        checked_at = time.monotonic()
        while self._feeds and not self.closing.is_set():
            feeds = dict(self._feeds)
            try:
                if time.monotonic() - checked_at > CHECK_SECONDS:
                    await self._end_revoked()
                    checked_at = time.monotonic()
                await self._read(self._read_all, feeds)
                for _ in range(LOOKS):
                    await asyncio.sleep(LOOK_SECONDS)
                    await self._read(self._read_logs, feeds)
            except Exception:
                _LOG.warning("events cannot be read at the moment", exc_info=True)
                await asyncio.sleep(1)

    async def _read(
        self, read: Callable[[dict[str, JobFeed]], None], feeds: dict[str, JobFeed]
    ) -> None:
        """Read in a thread, and publish what could be."""
        try:
            await anyio.to_thread.run_sync(read, feeds, limiter=self._thread)
        finally:
            for feed in feeds.values():
                feed.publish()

    async def _end_revoked(self) -> None:
        """End the streams of keys and share links that have been revoked since they began."""
        streams = [*self._open]  # others may come meanwhile
        valid = await self._still_valid({stream.caller for stream in streams})
        for stream in streams:
            if stream.caller not in valid:
                self._open.discard(stream)
                if stream.feed.ready.is_set():  # else it looks by itself
                    stream.feed.wake()

    def _read_all(self, feeds: dict[str, JobFeed]) -> None:
        """Fetch and read logs; one that cannot be read keeps none of the others from it."""
        states = self._queue.states(feeds)
        self._unreadable &= feeds.keys()
        for job_id, feed in feeds.items():
            try:
                self._fetch_log(job_id)
                feed.read(states.get(job_id))
                self._unreadable.discard(job_id)
            except Exception:
                if job_id not in self._unreadable:
                    _LOG.warning("events of job %s cannot be read", job_id, exc_info=True)
                self._unreadable.add(job_id)

    def _read_logs(self, feeds: dict[str, JobFeed]) -> None:
        """Read logs as they are here; states are as the last poll found them."""
        for job_id in feeds.keys() - self._unreadable:
            feeds[job_id].read(feeds[job_id].state)

    def _fetch_log(self, job_id: str) -> None:
        """See to it that the events of a job are here; while that fails, streams tell states."""
        if time.monotonic() < self._away_until:
            return
        try:
            self._storage.fetch(job_id, log_only=True)
        except (OSError, StoreUnavailableError) as error:
            self._away_until = time.monotonic() + AWAY_SECONDS
            _LOG.warning("events cannot be fetched at the moment: %s", error)


def encode_event(event: Event) -> bytes:
    """An event as a server-sent event."""
    return format_sse_event(data_str=event.model_dump_json(), event=event.type, id=str(event.id))


def state_event(after: int, state: JobState) -> Event:
    """A change of state; it has the id of the last event before it."""
    return Event(id=after, type="state", at=datetime.now(timezone.utc), data={"state": state.value})
