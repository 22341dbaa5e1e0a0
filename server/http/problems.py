"""One shape for every error: RFC 9457 problem+json, with a cause and a remedy."""

from __future__ import annotations

import errno
import json
import logging
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chamfer_morph.schemas import ProblemDocument
from chamfer_morph.worker.dbos_adapter import is_disk_full as is_database_full
from chamfer_morph.worker.queue import JobChangedError
from chamfer_morph.worker.storage import StoreUnavailableError
from morph_engine.errors import DamagedError, MorphError

MEDIA_TYPE = "application/problem+json"

PROBLEM_TYPES: dict[int, tuple[str, str]] = {
    400: ("malformed", "Malformed request"),
    401: ("unauthorized", "Valid key required"),
    403: ("forbidden", "Not permitted with this key"),
    404: ("not-found", "Not found"),
    405: ("method-not-allowed", "Method not allowed"),
    408: ("stalled", "Upload timed out"),
    409: ("conflict", "Conflict"),
    413: ("too-large", "Too large"),
    415: ("unsupported-type", "Unsupported format"),
    416: ("range", "Range not satisfiable"),
    422: ("invalid", "Invalid request"),
    429: ("too-many", "Limit reached"),
    431: ("headers-too-large", "Headers too large"),
    500: ("internal", "Internal error"),
    503: ("unavailable", "Service unavailable"),
    507: ("disk-full", "Out of disk space"),
}
"""Status to the stable name of the problem and its title."""

FAULTS_SHOWN = 20
NAME_SHOWN = 80
TEXT_SHOWN = 1000
"""Faults of one request that are listed, and letters of a field's name and of any text: whoever
sends much is not answered with as much."""

KEPT_HEADERS = ("allow", "content-range", "retry-after", "www-authenticate")
"""What is kept of an answer of the framework that becomes a problem."""

_LOG = logging.getLogger(__name__)


class ProblemError(HTTPException):
    """An answer other than the one asked for.

    Args:
        status: HTTP status, one of `PROBLEM_TYPES`.
        detail: What is wrong.
        remedy: What to do about it.
        headers: Further headers of the answer.
        errors: Faults of single fields.
    """

    def __init__(
        self,
        status: int,
        detail: str,
        remedy: str = "",
        *,
        headers: Mapping[str, str] | None = None,
        errors: Sequence[dict[str, Any]] = (),
    ) -> None:
        super().__init__(status, detail)
        self.remedy = remedy
        self.headers: dict[str, str] = dict(headers or {})
        self.errors: list[dict[str, Any]] = list(errors)

    def document(self) -> ProblemDocument:
        """The body of the answer."""
        name, title = PROBLEM_TYPES.get(
            self.status_code, PROBLEM_TYPES[400 if self.status_code < 500 else 500]
        )
        return ProblemDocument(
            type=f"/problems/{name}",
            title=title,
            status=self.status_code,
            detail=shorten(self.detail),
            remedy=shorten(self.remedy),
            errors=self.errors,
        )

    def response(self) -> Response:
        """The answer."""
        body = json.dumps(self.document().model_dump(mode="json"))
        return Response(body, self.status_code, self.headers, MEDIA_TYPE)


def shorten(text: str) -> str:
    """A text that may quote what somebody has sent, with its middle left out where it is long."""
    half = TEXT_SHOWN // 2
    return text if len(text) <= TEXT_SHOWN else f"{text[:half]} ... {text[-half:]}"


def not_found(what: str, name: str) -> ProblemError:
    """There is none of that name, or none that the caller may see."""
    return ProblemError(404, f"There is no {what} {name[:80]!r}.", "Check the id and the key.")


def too_large(max_bytes: int) -> ProblemError:
    """The refusal of a body or file that is too large."""
    text = f"{max_bytes / 2**20:.0f} MiB" if max_bytes >= 1 << 20 else f"{max_bytes} bytes"
    return ProblemError(
        413,
        f"This is larger than the limit of {text}.",
        "Send less data; a mesh can be decimated, as the simulation resolves no detail "
        "below half a grid unit.",
        headers={"Connection": "close", "Retry-After": "60"},
    )


def unavailable(detail: str, remedy: str = "Try again in a few seconds.") -> ProblemError:
    """Something that the service needs is not there at the moment."""
    return ProblemError(503, detail, remedy, headers={"Retry-After": "5"})


def disk_full() -> ProblemError:
    """Nothing can be written."""
    return ProblemError(
        507,
        "The disk of the service is full.",
        "Try again later; an administrator of the service has to free some space.",
        headers={"Retry-After": "60"},
    )


def damaged_result() -> ProblemError:
    """What a job has left cannot be read."""
    return ProblemError(
        500,
        "The result of the job is missing or damaged on the server.",
        "Tell an administrator, who finds the file in the log of the service; if it cannot be "
        "restored, retry the job.",
    )


def is_disk_full(error: BaseException | None) -> bool:
    """Whether a file or a database cannot be written for want of space."""
    if isinstance(error, OSError):
        return error.errno in (errno.ENOSPC, errno.EDQUOT)
    return is_database_full(error)


def not_json(error: ValueError | RecursionError) -> ProblemError:
    """The refusal of a body that is not JSON, or nested too deeply to be read."""
    if isinstance(error, RecursionError):
        return ProblemError(422, "The JSON is nested too deeply.", "Flatten it.")
    return ProblemError(422, f"The body is not JSON: {error}.", "Check it with a JSON linter.")


def validation_problem(error: ValidationError | RequestValidationError) -> ProblemError:
    """Fields that are missing, unknown or out of range."""
    found = error.errors()
    faults = [
        {"loc": _path_in_body(fault["loc"]), "msg": shorten(fault["msg"]), "type": fault["type"]}
        for fault in found[:FAULTS_SHOWN]
    ]
    first = faults[0]
    location = ".".join(str(part) for part in first["loc"])
    more = f" There are {len(found)} errors." if len(found) > FAULTS_SHOWN else ""
    return ProblemError(
        422,
        (f"{location}: {first['msg']}." if location else f"{first['msg']}.") + more,
        "See /docs for the fields and their allowed values.",
        errors=faults,
    )


def _path_in_body(loc: Sequence[str | int]) -> list[str | int]:
    """Where a field is; FastAPI says before it that it is in the body."""
    path = loc[1:] if loc[0:1] == ("body",) else loc
    return [part[:NAME_SHOWN] if isinstance(part, str) else part for part in path]


def install(app: FastAPI) -> None:
    """Answer every error of an application in the one shape."""

    async def problem(request: Request, error: Exception) -> Response:
        found = as_problem(error)
        folder = f"{app.state.context.storage.root}{os.sep}"  # which is nobody's business
        found.detail, found.remedy = (
            text.replace(folder, "") for text in (found.detail, found.remedy)
        )
        if found.status_code == 500 and isinstance(error, OSError | DamagedError):
            _LOG.error("%s %s", request.method, request.url.path, exc_info=error)
        if found.status_code == 405:
            found.headers["Allow"] = ", ".join(_allowed_methods(app, request.url.path))
        return found.response()

    for kind in (
        MorphError,
        RequestValidationError,
        HTTPException,
        ClientDisconnect,
        OperationalError,
        InterfaceError,
        PoolTimeoutError,
        JobChangedError,
        OSError,
        Exception,
    ):
        app.add_exception_handler(kind, problem)
    app.add_middleware(ProblemMiddleware)


def as_problem(error: Exception) -> ProblemError:
    """The answer to an exception."""
    if isinstance(error, ProblemError):
        return error
    if isinstance(error, StoreUnavailableError):
        return unavailable(error.cause)
    if isinstance(error, DamagedError):
        return damaged_result()
    if isinstance(error, MorphError):
        return ProblemError(422, error.cause, error.remedy)
    if isinstance(error, RequestValidationError):
        return _request_problem(error)
    if isinstance(error, HTTPException):
        cause = error.__cause__
        if isinstance(cause, (ValueError, RecursionError)):  # FastAPI could not read the body
            return not_json(cause)
        if isinstance(cause, ClientDisconnect):
            return as_problem(cause)
        return _http_problem(error.status_code, str(error.detail), error.headers)
    if isinstance(error, ClientDisconnect):
        return ProblemError(400, "The request body is incomplete.", "Send it again.")
    if isinstance(error, JobChangedError):
        return ProblemError(
            409,
            "The job was changed by another request in the meantime.",
            "Check its current state.",
        )
    if is_disk_full(error.orig if isinstance(error, DBAPIError) else error):
        return disk_full()
    if isinstance(error, (OperationalError, InterfaceError, PoolTimeoutError)):
        return unavailable("The database does not answer.")
    return ProblemError(
        500,
        f"Internal error: {type(error).__name__}.",
        "Try again; if the error persists, report it with the log of the service.",
    )


def _request_problem(error: RequestValidationError) -> ProblemError:
    """Parameters or a body that FastAPI has refused."""
    if isinstance(error.__cause__, ValueError):
        return not_json(error.__cause__)
    if isinstance(error.body, bytes):  # FastAPI parses nothing but JSON
        return ProblemError(
            415, "The body is not JSON.", "Send it with Content-Type: application/json."
        )
    return validation_problem(error)


def _allowed_methods(app: FastAPI, path: str) -> list[str]:
    """All methods of an address; the framework names those of the first route it finds."""
    return sorted(
        {
            method.upper()
            for template, item in app.openapi()["paths"].items()
            if re.fullmatch(re.sub(r"{\w+}", "[^/]+", template), path)
            for method in item
        }
        or {"GET"}  # the pages about the contract are not in it
    )


def _http_problem(status: int, detail: str, headers: Mapping[str, str] | None) -> ProblemError:
    remedies = {
        404: "See /docs for all addresses.",
        405: "See /docs for the methods that this address supports.",
        416: "Request a range within the length given by Content-Range.",
    }
    return ProblemError(
        status, f"{detail.rstrip('.')}.", remedies.get(status, "See /docs."), headers=headers
    )


class ProblemMiddleware:
    """Turns the plain-text errors of the framework, such as 416, into the one shape."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        replaced = False

        async def send_problem(message: Message) -> None:
            nonlocal replaced
            if message["type"] == "http.response.start" and message["status"] >= 400:
                headers = Headers(raw=message["headers"])
                if headers.get("content-type", "text/plain").startswith("text/plain"):
                    replaced = True
                    _, title = PROBLEM_TYPES.get(message["status"], PROBLEM_TYPES[400])
                    kept = {name: headers[name] for name in KEPT_HEADERS if name in headers}
                    found = _http_problem(message["status"], title, kept)
                    await found.response()(scope, receive, send)
            if not replaced:
                await send(message)

        await self.app(scope, receive, send_problem)
