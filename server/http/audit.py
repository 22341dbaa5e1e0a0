"""A name for every request, and a line in the log for every request that may change something.

The name comes back in the header `X-Request-ID`. A caller, or a proxy, may give one of its own, so
that its log and ours can be laid side by side.
"""

from __future__ import annotations

import json
import logging
import re
import time
import uuid
from datetime import datetime, timezone
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chamfer_morph.server.database.callers import Caller
from chamfer_morph.worker import service_log, telemetry

HEADER = "X-Request-ID"

GIVEN = re.compile(r"[\w.:-]{1,64}", re.ASCII)
"""Names of callers that are taken as they are: nothing in them can break a line of the log."""

JOB = re.compile(r"/jobs/([^/]+)$")
"""The end of a job's address."""

READING = ("GET", "HEAD", "OPTIONS")

PATH_SHOWN = 200
"""Letters of a path that are logged: addresses may be much longer."""

JOB_SHOWN = 26
"""Letters of the id of a job, which has no more."""

_log: logging.Logger = logging.getLogger("chamfer_morph.audit")


class AuditMiddleware:
    """Names requests, and logs those that may change something once they are answered.

    A line is one JSON object: `time` in UTC, `request`, `key` (empty without one), `operation`,
    `method`, `path`, `job` (that is made or meant; or empty), `status`, and `seconds` until the
    answer began. A refused request has a line, too; a status of 0 says that nothing was answered.
    The line of a new key also has `new_key`, its name, and `scopes`. No line has a body, a
    query or a secret.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        given = Headers(scope=scope).get(HEADER, "")
        name = given if GIVEN.fullmatch(given) else uuid.uuid4().hex
        service_log.request_id.set(name)
        begun, status, seconds, made = time.perf_counter(), 0, 0.0, ""

        async def send_named(message: Message) -> None:
            nonlocal status, seconds, made
            if message["type"] == "http.response.start":
                status, seconds = message["status"], time.perf_counter() - begun
                headers = MutableHeaders(scope=message)
                headers[HEADER] = name
                made = headers.get("Location", "")
                if job := _job(scope, made):
                    telemetry.annotate({"morph.job.id": job})
            await send(message)

        try:
            await self.app(scope, receive, send_named)
        finally:
            state = scope.get("state", {})
            if scope["method"] not in READING:
                line = _line(scope, state.get("caller"), name, status, seconds)
                line |= {"job": _job(scope, made)} | state.get("audited", {})
                _log.info(json.dumps(line), extra={"fields": line | {"message": "request"}})


def _job(scope: Scope, made: str) -> str:
    """The job that a request is about: that of its path, or the one that it has made."""
    new = JOB.search(made)
    job: str = new[1] if new else scope.get("path_params", {}).get("job_id", "")
    return job[:JOB_SHOWN]


def _line(
    scope: Scope, caller: Caller | None, name: str, status: int, seconds: float
) -> dict[str, Any]:
    return {
        "time": _now(),
        "request": name,
        "key": caller.name if caller else "",
        "operation": getattr(scope.get("route"), "operation_id", None) or "",
        "method": scope["method"],
        "path": scope["path"][:PATH_SHOWN],
        "status": status,
        "seconds": round(seconds, 4),
    }


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")
