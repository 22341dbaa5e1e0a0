"""A span for every request of the API, in the trace of the caller if it names one."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chamfer_morph.server.http.audit import job_of
from chamfer_morph.worker import telemetry

API = "/v1"
"""Beginning of the paths that are traced: probes, metrics and the page are not."""


class TraceMiddleware:
    """Traces requests by method and route; no span has a path, a query or an address."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] != "http" or not scope["path"].startswith(f"{API}/"):
            await self.app(scope, receive, send)
            return
        method, status, made = scope["method"], 0, ""

        async def send_noting(message: Message) -> None:
            nonlocal status, made
            if message["type"] == "http.response.start":
                status, made = (
                    message["status"],
                    Headers(raw=message["headers"]).get("Location", ""),
                )
            await send(message)

        caller = telemetry.carried(Headers(scope=scope))
        about = {"http.request.method": method}
        with telemetry.span(method, about, parent=caller, kind="server") as span:
            try:
                await self.app(scope, receive, send_noting)
            finally:
                if status:
                    span.set({"http.response.status_code": status})
                if status >= 500:
                    span.fail("")
                if path := getattr(scope.get("route"), "path", ""):
                    route = API + path.removeprefix(API)  # which FastAPI may leave out
                    span.rename(f"{method} {route}")
                    span.set({"http.route": route})
                if job := job_of(scope, made):
                    span.set({"morph.job.id": job})
