"""The load, as a process of its own: `python -m benchmarks.service.requests_and_watchers`.

It reads one JSON document from standard input: `url`, `jobs` and `bursts`, each from and to a time
[s since 1970]. After each burst it prints what that one saw, as a line of JSON.

It shares the machine with what is measured, and so it is made to be light: aiohttp, whose parser is
compiled, on uvloop.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from dataclasses import asdict, dataclass, field
from itertools import cycle

import aiohttp
import uvloop

WATCHERS = 50
REQUESTS_PER_SECOND = 100


@dataclass
class Burst:
    """What a burst of load saw.

    Attributes:
        latencies: From when a request was due until its answer was there [s].
        delays: From when a request was due until it was sent, which is no fault of the API [s].
        events: Server-sent events that arrived.
        errors: What went wrong.
    """

    latencies: list[float] = field(default_factory=list)
    delays: list[float] = field(default_factory=list)
    events: int = 0
    errors: list[str] = field(default_factory=list)


async def main(url: str, jobs: list[str], bursts: list[tuple[float, float]]) -> None:
    """Load the API in each burst, and rest between them."""
    for begin, end in bursts:
        await asyncio.sleep(begin - time.time())
        seen = Burst()
        async with session(url) as asker, session(url) as watcher:
            watching = [
                asyncio.create_task(watch(watcher, jobs[i % len(jobs)], i / WATCHERS, seen))
                for i in range(WATCHERS)
            ]
            await ask_until(asker, jobs, end, seen)
            for task in watching:
                task.cancel()
            await asyncio.gather(*watching, return_exceptions=True)
        print(json.dumps(asdict(seen)), flush=True)


def session(url: str) -> aiohttp.ClientSession:
    """A client with as many connections as it needs."""
    return aiohttp.ClientSession(
        url,
        connector=aiohttp.TCPConnector(limit=0),
        timeout=aiohttp.ClientTimeout(total=None, sock_connect=20, sock_read=20),
    )


async def ask_until(
    client: aiohttp.ClientSession, jobs: list[str], end: float, seen: Burst
) -> None:
    """Send requests at their times, however long the answers take."""
    paths = cycle(
        [
            path
            for job in jobs
            for path in ("/v1/jobs", f"/v1/jobs/{job}", f"/v1/jobs/{job}/metrics", "/livez")
        ]
    )
    asking = []
    due = time.time()
    while due < end:
        await asyncio.sleep(due - time.time())
        asking.append(asyncio.create_task(ask(client, next(paths), due, seen)))
        due += 1 / REQUESTS_PER_SECOND
    await asyncio.gather(*asking)


async def ask(client: aiohttp.ClientSession, path: str, due: float, seen: Burst) -> None:
    """Send one request."""
    seen.delays.append(time.time() - due)
    try:
        async with client.get(path) as answer:
            content = await answer.read()
        seen.latencies.append(time.time() - due)
        if answer.status != 200:
            seen.errors.append(f"{path}: {answer.status} {content[:200]!r}")
    except (aiohttp.ClientError, TimeoutError) as error:
        seen.errors.append(f"{path}: {error!r}")


async def watch(client: aiohttp.ClientSession, job: str, pause: float, seen: Burst) -> None:
    """After a pause [s], watch a job until cancelled; an earlier end is an error."""
    await asyncio.sleep(pause)
    headers = {"Accept": "text/event-stream"}
    try:
        async with client.get(f"/v1/jobs/{job}/events", headers=headers) as stream:
            async for line in stream.content:
                seen.events += line.startswith(b"data:")
        seen.errors.append(f"watcher of {job}: status {stream.status}, and the stream ended")
    except (aiohttp.ClientError, TimeoutError) as error:
        seen.errors.append(f"watcher of {job}: {error!r}")


if __name__ == "__main__":
    uvloop.run(main(**json.load(sys.stdin)))
