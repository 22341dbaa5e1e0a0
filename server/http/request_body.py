"""Request bodies: their size, how long they may stall, and JSON that FastAPI does not read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TypeVar

import anyio
from pydantic import BaseModel, ValidationError
from starlette.middleware.body_limit import RequestBodyLimitMiddleware
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chamfer_morph.server.http.problems import (
    ProblemError,
    not_json,
    too_large,
    validation_problem,
)

Model = TypeVar("Model", bound=BaseModel)


class BodySizeMiddleware:
    """Starlette's limit on the size of a body, another one for each address.

    FastAPI takes the limit with a router, but no release for Python 3.10 does.

    Args:
        app: The application.
        max_body_size: The limit [bytes].
        exceptions: The limit of the addresses that have another one [bytes].
    """

    def __init__(self, app: ASGIApp, max_body_size: int, exceptions: Mapping[str, int]) -> None:
        self.default = RequestBodyLimitMiddleware(app, max_body_size)
        self.by_path = {
            path: RequestBodyLimitMiddleware(app, size) for path, size in exceptions.items()
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        limited = self.by_path.get(scope.get("path", ""), self.default)
        await limited(scope, receive, send)


class BodyTimeoutMiddleware:
    """Refuses a request of whose body nothing comes for a while; FastAPI would wait for ever.

    Args:
        app: The application.
        timeout_seconds: How long to wait for the next piece [s].
    """

    def __init__(self, app: ASGIApp, timeout_seconds: float) -> None:
        self.app = app
        self.timeout_seconds = timeout_seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        more_body = True

        async def receive_in_time() -> Message:
            nonlocal more_body
            if not more_body:  # what comes now is the disconnect, at any time
                return await receive()
            try:
                with anyio.fail_after(self.timeout_seconds):
                    message = await receive()
            except TimeoutError:
                raise ProblemError(
                    408,
                    f"Nothing has come for {self.timeout_seconds:g} s.",
                    "Send it again, over a steadier connection.",
                    headers={"Connection": "close"},
                ) from None
            more_body = message.get("more_body", False)
            return message

        await self.app(scope, receive_in_time, send)


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
