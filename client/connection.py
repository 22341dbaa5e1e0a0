"""Calls over HTTP, awaited or blocking, behind one interface.

What a call means is written once, as coroutines over a `Transport`. Over `BlockingTransport` these
never suspend, so `finish` and `iterate` run them to their end without an event loop.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, AsyncIterator, Coroutine, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import httpx
from pydantic import BaseModel

T = TypeVar("T")

CHUNK_BYTES = 1 << 18
UPLOAD_TIMEOUT = httpx.Timeout(30.0, read=180.0)
"""The service reads a mesh before it answers [s]."""

COMPUTING_TIMEOUT = httpx.Timeout(30.0, read=900.0)
"""The service computes a surface or fills a shape before it answers, maybe after others [s]."""


@dataclass(frozen=True)
class Call:
    """One request to the service.

    Attributes:
        method: HTTP method.
        path: Path below /v1.
        query: Parameters; those that are None are left out.
        body: Sent as JSON.
        upload: File sent as it is.
        headers: Further headers.
        repeatable: Whether it may reach the service twice.
        timeout: Other than the client's usual one [s].
    """

    method: str
    path: str
    query: Mapping[str, Any] = field(default_factory=dict)
    body: BaseModel | None = None
    upload: Path | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    repeatable: bool = False
    timeout: httpx.Timeout | None = None

    def arguments(self) -> dict[str, Any]:
        """All of it but the file, as httpx takes it."""
        query = {name: value for name, value in self.query.items() if value is not None}
        headers = dict(self.headers)
        content = None
        if self.body is not None:
            content = self.body.model_dump_json()
            headers["Content-Type"] = "application/json"
        elif self.upload is not None:
            headers["Content-Type"] = "application/octet-stream"
            headers["Content-Length"] = str(self.upload.stat().st_size)
        timeout = self.timeout or (UPLOAD_TIMEOUT if self.upload else httpx.USE_CLIENT_DEFAULT)
        return {
            "method": self.method,
            "url": f"/v1{self.path}",
            "params": query,
            "content": content,
            "headers": headers,
            "timeout": timeout,
        }


@dataclass(frozen=True)
class Reply:
    """An answer whose body arrives piece by piece; the body of an error is there already.

    Attributes:
        response: Status and headers.
        chunks: The body.
    """

    response: httpx.Response
    chunks: AsyncIterator[bytes]


class Transport(Protocol):
    """Sends calls."""

    server: str

    async def send(self, call: Call) -> httpx.Response:
        """The whole answer.

        Raises:
            httpx.TransportError: There is none.
        """

    def open(self, call: Call) -> AbstractAsyncContextManager[Reply]:
        """The answer while it arrives; errors as of `send`, at any piece."""

    async def sleep(self, seconds: float) -> None:
        """Wait."""

    async def close(self) -> None:
        """Close all connections."""


class AsyncTransport:
    """Awaits, for use in an event loop; options are those of httpx.AsyncClient."""

    def __init__(self, server: str, **options: Any) -> None:
        self.server = server
        self._http = httpx.AsyncClient(base_url=server, **options)

    async def send(self, call: Call) -> httpx.Response:
        """See `Transport`."""
        return await self._http.request(**self._arguments(call))

    @asynccontextmanager
    async def open(self, call: Call) -> AsyncIterator[Reply]:
        """See `Transport`."""
        async with self._http.stream(**self._arguments(call)) as response:
            if response.is_error:
                await response.aread()
            yield Reply(response, response.aiter_bytes())

    async def sleep(self, seconds: float) -> None:
        """See `Transport`."""
        await asyncio.sleep(seconds)

    async def close(self) -> None:
        """See `Transport`."""
        await self._http.aclose()

    def _arguments(self, call: Call) -> dict[str, Any]:
        arguments = call.arguments()
        if call.upload is not None:
            arguments["content"] = self._file(call.upload)
        return arguments

    @staticmethod
    async def _file(path: Path) -> AsyncIterator[bytes]:
        with path.open("rb") as file:
            while chunk := await asyncio.to_thread(file.read, CHUNK_BYTES):
                yield chunk


class BlockingTransport:
    """Blocks the thread; options are those of httpx.Client."""

    def __init__(self, server: str, **options: Any) -> None:
        self.server = server
        self._http = httpx.Client(base_url=server, **options)

    async def send(self, call: Call) -> httpx.Response:
        """See `Transport`."""
        return self._http.request(**self._arguments(call))

    @asynccontextmanager
    async def open(self, call: Call) -> AsyncIterator[Reply]:
        """See `Transport`."""
        with self._http.stream(**self._arguments(call)) as response:
            if response.is_error:
                response.read()
            yield Reply(response, _awaitable(response.iter_bytes()))

    async def sleep(self, seconds: float) -> None:
        """See `Transport`."""
        time.sleep(seconds)

    async def close(self) -> None:
        """See `Transport`."""
        self._http.close()

    def _arguments(self, call: Call) -> dict[str, Any]:
        arguments = call.arguments()
        if call.upload is not None:
            arguments["content"] = self._file(call.upload)
        return arguments

    @staticmethod
    def _file(path: Path) -> Iterator[bytes]:
        with path.open("rb") as file:
            while chunk := file.read(CHUNK_BYTES):
                yield chunk


async def _awaitable(items: Iterator[T]) -> AsyncIterator[T]:
    for item in items:
        yield item


def finish(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine that never suspends."""
    try:
        coroutine.send(None)
    except StopIteration as stop:
        result: T = stop.value
        return result
    raise RuntimeError("a blocking transport does not suspend")


def iterate(items: AsyncGenerator[T, None]) -> Iterator[T]:
    """Iterate over what never suspends."""

    async def step() -> T:
        return await items.__anext__()

    async def close() -> None:
        await items.aclose()

    try:
        while True:
            try:
                item = finish(step())
            except StopAsyncIteration:
                return
            yield item
    finally:
        finish(close())
