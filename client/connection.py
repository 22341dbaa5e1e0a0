"""Requests to the service, sent again when they fail in passing."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

import anyio
import httpx
from pydantic import TypeAdapter, ValidationError

from chamfer_morph.client.errors import ServiceError, unexpected_answer
from chamfer_morph.client.retry import FEW_ATTEMPTS, MANY_ATTEMPTS, Attempts
from chamfer_morph.client.trace_context import add_trace_context

T = TypeVar("T")

DEFAULT_SERVER = "http://127.0.0.1:8000"
DEFAULT_TIMEOUT_SECONDS = 30.0

CHUNK_BYTES = 1 << 18


class FileContent:
    """The content of a file, in pieces, as often as it is asked for."""

    def __init__(self, path: Path) -> None:
        self._path = path

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async with await anyio.open_file(self._path, "rb") as file:
            while chunk := await file.read(CHUNK_BYTES):
                yield chunk


class Connection:
    """Connections to a service, opened when needed; see `MorphClient`.

    Raises:
        ServiceError: The address or the key cannot be one.
    """

    def __init__(self, server: str | None, key: str | None, timeout_seconds: float) -> None:
        self.server: str = (server or os.environ.get("MORPH_SERVER") or DEFAULT_SERVER).rstrip("/")
        secret = key or os.environ.get("MORPH_KEY") or ""
        try:
            address = httpx.URL(self.server)
        except httpx.InvalidURL:
            address = httpx.URL()
        if address.scheme not in ("http", "https") or not address.host:
            raise ServiceError(
                f"{self.server} is not the address of a service.",
                "Write it as http://127.0.0.1:8000.",
                400,
            )
        if not (secret.isascii() and secret.isprintable()):
            raise ServiceError("The API key contains invalid characters.", "Copy it again.", 401)
        self._http = httpx.AsyncClient(
            base_url=f"{self.server}/v1",
            headers={"Authorization": f"Bearer {secret}"} if secret else {},
            timeout=timeout_seconds,
            event_hooks={"request": [add_trace_context]},
        )

    async def send(
        self,
        method: str,
        path: str,
        *,
        repeatable: bool = False,
        wait_for_service: bool = False,
        **options: Any,
    ) -> httpx.Response:
        """The answer to a request for a path below /v1; options are those of httpx.

        One that is `repeatable` may reach the service twice. A service that is away is waited for
        about a minute, or else for a few seconds.

        Raises:
            ServiceError: The service refuses or does not answer.
        """
        limit = MANY_ATTEMPTS if wait_for_service else FEW_ATTEMPTS
        attempts = Attempts(self.server, limit=limit, repeatable=repeatable)
        while True:
            try:
                response = await self._http.request(method, path, **options)
            except httpx.TransportError as error:
                await attempts.pause_after_loss(error)
                continue
            if response.is_success:
                return response
            await attempts.pause_after_refusal(response)

    async def get(
        self,
        path: str,
        *,
        wait_for_service: bool = False,
        timeout: httpx.Timeout | None = None,
        **query: Any,
    ) -> httpx.Response:
        """The answer to GET; parameters of the query that are None are left out."""
        return await self.send(
            "GET",
            path,
            params={name: value for name, value in query.items() if value is not None},
            repeatable=True,
            wait_for_service=wait_for_service,
            timeout=timeout or httpx.USE_CLIENT_DEFAULT,
        )

    @asynccontextmanager
    async def stream(self, path: str, **options: Any) -> AsyncIterator[httpx.Response]:
        """The answer to GET while it arrives, unchecked; the body of an error is there already.

        Raises:
            httpx.TransportError: There is none, or it breaks off.
        """
        async with self._http.stream("GET", path, **options) as response:
            if response.is_error:
                await response.aread()
            yield response

    def parse(self, type_: type[T], content: str | bytes) -> T:
        """The body of an answer as what it should be.

        Raises:
            ServiceError: It is something else.
        """
        try:
            return TypeAdapter(type_).validate_json(content)
        except ValidationError:
            raise unexpected_answer(self.server) from None

    async def close(self) -> None:
        """Close all connections."""
        await self._http.aclose()
