"""Without keys the service is for its own machine: for no other site, and through no proxy."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from chamfer_morph.server.auth import Authenticator, is_loopback
from chamfer_morph.server.http.problems import ProblemError

FORWARDED = ("forwarded", "x-forwarded-", "x-real-ip")
"""Beginnings of the headers that proxies add."""

HEALTH = ("/livez", "/readyz")
"""Answered to anybody, and without a look at the keys, which the database may not give."""


class LocalOnlyMiddleware:
    """Checks every request as long as there are no keys: endpoints, page, contract and figures."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] == "http" and scope["path"] not in HEALTH:
            authenticator: Authenticator = scope["app"].state.context.authenticator
            if await authenticator.is_open():
                refusal = refuse(scope["method"], Headers(scope=scope))
                if refusal is not None:
                    await refusal.response()(scope, receive, send)
                    return
        await self.app(scope, receive, send)


def refuse(method: str, headers: Headers) -> ProblemError | None:
    """Why a request without a key is none of this machine, if it is not."""
    host = headers.get("host", "")
    if not is_loopback(_name(host)):
        return ProblemError(
            403,
            "Without keys, this service can be used only under the names of its own "
            f"machine, not as {host!r}.",
            "Use 127.0.0.1 or localhost, or make a key.",
        )
    if any(name.startswith(FORWARDED) for name in headers):
        return ProblemError(
            403,
            "Without keys, this service cannot be used through a proxy.",
            "Make a key before you give others access.",
        )
    origin = headers.get("origin")
    foreign = origin is not None and origin.partition("://")[2].lower() != host.lower()
    site = headers.get("sec-fetch-site")
    visit = method == "GET" and headers.get("sec-fetch-mode") == "navigate"
    if foreign or (site in ("cross-site", "same-site") and not visit):
        return ProblemError(
            403, "Pages of other sites may not do this without a key.", "Make a key."
        )
    return None


def _name(host: str) -> str:
    """The name in a Host header, without its port."""
    if host.startswith("["):
        return host.partition("]")[0]
    return host.rpartition(":")[0] if ":" in host else host
