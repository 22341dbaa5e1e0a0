"""Request bodies: their size, how long they may stall, and JSON that FastAPI does not read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TypeVar

import anyio
from pydantic import BaseModel, ValidationError
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chamfer_morph.server.http.problems import (
    ProblemError,
    not_json,
    too_large,
    validation_problem,
)

Model = TypeVar("Model", bound=BaseModel)


class BodyLimitMiddleware:
    """Refuses a body that is too large, takes too long, or of which nothing comes for a while.

    FastAPI would wait for ever. Starlette's limit of the size would answer 413 in place of 401 to
    strangers.

    Args:
        app: The application.
        timeout_seconds: How long to wait for the next piece [s].
        deadline_seconds: How long to wait for all of them [s].
        max_bytes: The limit [bytes].
        exceptions: The limit of the addresses that have another one [bytes].
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        timeout_seconds: float,
        deadline_seconds: float,
        max_bytes: int,
        exceptions: Mapping[str, int],
    ) -> None:
        self.app = app
        self.timeout_seconds = timeout_seconds
        self.deadline_seconds = deadline_seconds
        self.max_bytes = max_bytes
        self.exceptions = exceptions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        max_bytes = self.exceptions.get(scope["path"], self.max_bytes)
        declared = int(Headers(scope=scope).get("content-length", 0))
        received, more_body = 0, True
        deadline = anyio.current_time() + self.deadline_seconds

        async def receive_limited() -> Message:
            nonlocal received, more_body
            if not more_body:  # what comes now is the disconnect, at any time
                return await receive()
            if declared > max_bytes:
                raise too_large(max_bytes)
            left = deadline - anyio.current_time()
            try:
                with anyio.fail_after(min(self.timeout_seconds, left)):
                    message = await receive()
            except TimeoutError:
                cause = f"No data arrived for {self.timeout_seconds:g} s."
                if left < self.timeout_seconds:
                    cause = f"The upload was not complete within {self.deadline_seconds:g} s."
                raise ProblemError(
                    408,
                    cause,
                    "Send it again, over a more stable connection.",
                    headers={"Connection": "close"},
                ) from None
            received += len(message.get("body", b""))
            if received > max_bytes:
                raise too_large(max_bytes)
            more_body = message.get("more_body", False)
            return message

        await self.app(scope, receive_limited, send)


def media_type(request: Request) -> str:
    """Type of the body in lower case, without parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def read_json(request: Request, model: type[Model], max_bytes: int) -> Model:
    """The body as JSON of a known shape.

    Raises:
        ProblemError: 415, 413 or 422.
    """
    if media_type(request) != "application/json":
        raise ProblemError(
            415, "The body is not JSON.", "Send it with Content-Type: application/json."
        )
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > max_bytes:
            raise too_large(max_bytes)
    return validate(load_json(bytes(body)), model)


def load_json(text: bytes | str) -> object:
    """Any JSON.

    Raises:
        ProblemError: 422.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise not_json(error) from None


def validate(value: object, model: type[Model]) -> Model:
    """A value of a known shape.

    Raises:
        ProblemError: 422.
    """
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise validation_problem(error) from None
