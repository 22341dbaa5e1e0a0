"""The load, as a process of its own: `python -m benchmarks.service.load_generator`.

It reads one JSON document from standard input: `url`, `jobs` and `bursts`, each from and to a time
[s since 1970]. After each burst it prints what that one saw, as a line of JSON.

It shares the machine with what is measured, so it has to be light: it speaks just as much HTTP as
the API answers with, over connections that it keeps, on uvloop. A general client takes about twice
the CPU time.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from dataclasses import asdict, dataclass, field
from itertools import cycle
from urllib.parse import urlsplit

import uvloop

WATCHERS = 50
REQUESTS_PER_SECOND = 100
PATIENCE_SECONDS = 20.0


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


class Failure(Exception):
    """An answer, or the lack of one, that counts as an error."""


class Client:
    """Sends GET requests to one server; a connection serves one at a time, and is kept.

    Args:
        url: The server.
    """

    def __init__(self, url: str) -> None:
        address = urlsplit(url)
        self._address = address.hostname or "", address.port or 80
        self._idle: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

    async def get(self, path: str) -> bytes:
        """The body of an answer that tells its length.

        Raises:
            Failure: It has another status than 200.
            OSError, EOFError: The connection broke.
        """
        reader, writer = self._idle.pop() if self._idle else await self._connect()
        head = await self._begin(reader, writer, path, "application/json")
        length = head.partition(b"content-length: ")[2].split(None, 1)[0]
        body = await reader.readexactly(int(length))
        self._idle.append((reader, writer))
        return body

    async def listen(self, path: str, seen: Burst) -> None:
        """Count server-sent events until the stream ends."""
        reader, writer = await self._connect()
        try:
            await self._begin(reader, writer, path, "text/event-stream")
            while line := await reader.readline():
                seen.events += line.startswith(b"data:")
        finally:
            writer.close()

    def close(self) -> None:
        """Close the connections that nobody uses."""
        for _, writer in self._idle:
            writer.close()

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection(*self._address, limit=1 << 20)

    async def _begin(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, path: str, accept: str
    ) -> bytes:
        """Send a request and read the head of its answer, in lower case."""
        lines = f"GET {path} HTTP/1.1", f"Host: {self._address[0]}", f"Accept: {accept}", "", ""
        writer.write("\r\n".join(lines).encode())
        head = (await reader.readuntil(b"\r\n\r\n")).lower()
        if not head.startswith(b"http/1.1 200 "):
            raise Failure(head.partition(b"\r\n")[0].decode())
        return head


async def main(url: str, jobs: list[str], bursts: list[tuple[float, float]]) -> None:
    """Load the API in each burst, and rest between them."""
    for begin, end in bursts:
        await asyncio.sleep(begin - time.time())
        seen, client = Burst(), Client(url)
        watching = [
            asyncio.create_task(watch(client, jobs[i % len(jobs)], i / WATCHERS, seen))
            for i in range(WATCHERS)
        ]
        await ask_until(client, jobs, end, seen)
        for task in watching:
            task.cancel()
        await asyncio.gather(*watching, return_exceptions=True)
        client.close()
        print(json.dumps(asdict(seen)), flush=True)


async def ask_until(client: Client, jobs: list[str], end: float, seen: Burst) -> None:
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


async def ask(client: Client, path: str, due: float, seen: Burst) -> None:
    """Send one request."""
    seen.delays.append(time.time() - due)
    try:
        await asyncio.wait_for(client.get(path), PATIENCE_SECONDS)
        seen.latencies.append(time.time() - due)
    except (Failure, OSError, EOFError, asyncio.TimeoutError) as error:
        seen.errors.append(f"{path}: {error!r}")


async def watch(client: Client, job: str, pause: float, seen: Burst) -> None:
    """After a pause [s], watch a job until cancelled; an earlier end is an error."""
    await asyncio.sleep(pause)
    try:
        await client.listen(f"/v1/jobs/{job}/events", seen)
        seen.errors.append(f"watcher of {job}: the stream ended")
    except (Failure, OSError, EOFError) as error:
        seen.errors.append(f"watcher of {job}: {error!r}")


if __name__ == "__main__":
    uvloop.run(main(**json.load(sys.stdin)))
