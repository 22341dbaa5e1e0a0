"""Authentication: bearer keys, share links, or neither from the same machine."""

from __future__ import annotations

import hmac
import ipaddress
import time
from collections.abc import Callable, Collection, Coroutine, Iterator
from contextlib import suppress
from functools import lru_cache
from typing import Annotated, Any

import anyio
from fastapi import Depends, Request, Response
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from chamfer_morph.schemas import Scope
from chamfer_morph.server.database.api_keys import ApiKeyStore
from chamfer_morph.server.database.callers import Caller, secret_digest
from chamfer_morph.server.database.share_links import PREFIX as SHARE_LINK
from chamfer_morph.server.database.share_links import ShareLinkStore
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.settings import Settings
from morph_engine.errors import ConfigError

CACHE_SECONDS = 1.0
"""A key revoked by another process works for so long."""

ANONYMOUS = Caller("", "admin")
"""The caller where no keys are needed."""

BEARER = HTTPBearer(
    scheme_name="key",
    description="A key made by `POST /v1/keys`. Requests from the same machine need none as long "
    "as there are no keys. The secret of a share link gives read access to one job.",
    auto_error=False,
)


@lru_cache(maxsize=256)
def is_loopback(host: str) -> bool:
    """Whether an address, or the name in a Host header, stays on this machine."""
    name = host.strip("[]").lower()
    if name == "localhost" or name.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def check_keys(settings: Settings, api_keys: ApiKeyStore) -> None:
    """Refuse to listen to other machines without keys.

    Raises:
        ConfigError: The address is not on loopback, and there is no key.
    """
    if not is_loopback(settings.host) and not api_keys.callers():
        raise ConfigError(
            f"Without keys, anyone who can reach {settings.host} could use this service.",
            "Set MORPH_ADMIN_KEY or MORPH_ADMIN_KEY_FILE, make a key with `python -m "
            "chamfer_morph.server keys add NAME --scope admin`, or listen on 127.0.0.1.",
        )


class Authenticator:
    """Finds the caller of a request.

    Args:
        api_keys: The keys.
        share_links: The share links, which are looked up at each request.
        open_without_keys: Whether no key is needed while there are none.
    """

    def __init__(
        self, api_keys: ApiKeyStore, share_links: ShareLinkStore, *, open_without_keys: bool
    ) -> None:
        self._api_keys = api_keys
        self._share_links = share_links
        self._open = open_without_keys
        self._callers: dict[str, Caller] = {}
        self._read_at = float("-inf")

    def invalidate(self) -> None:
        """Read the keys again at the next request."""
        self._read_at = float("-inf")

    async def authenticate(self, secret: str | None) -> Caller:
        """The caller.

        Raises:
            ProblemError: 401 for a missing or wrong key.
        """
        if secret is not None and secret.startswith(SHARE_LINK):
            return await self._find_link(secret)
        await self._read()
        if secret is not None:
            return self._find(secret)
        if self._callers or not self._open:
            raise _unauthorized("This requires a key.")
        return ANONYMOUS

    async def still_valid(self, callers: Collection[Caller]) -> set[Caller]:
        """Those of some callers whose key or share link has not been revoked since."""
        await self._read()
        known = {*self._callers.values()}
        if not self._callers and self._open:
            known.add(ANONYMOUS)
        if links := {caller.digest for caller in callers if caller.shared is not None}:
            found = await anyio.to_thread.run_sync(self._share_links.callers, links)
            known.update(found.values())
        return known & {*callers}

    async def is_open(self) -> bool:
        """Whether no key is needed, as far as that is known."""
        if not self._open:
            return False
        with suppress(Exception):  # what is asked for needs the database, too, and tells it
            await self._read()
        return not self._callers

    async def _read(self) -> None:
        if time.monotonic() - self._read_at > CACHE_SECONDS:
            self._callers = await anyio.to_thread.run_sync(self._api_keys.callers)
            self._read_at = time.monotonic()

    def _find(self, secret: str) -> Caller:
        digest = secret_digest(secret)
        for stored, caller in self._callers.items():
            if hmac.compare_digest(stored, digest):
                return caller
        raise key_revoked()

    async def _find_link(self, secret: str) -> Caller:
        digest = secret_digest(secret)
        found = await anyio.to_thread.run_sync(self._share_links.callers, [digest])
        if digest not in found:
            raise _unauthorized(
                "This share link is unknown or revoked.", "Ask the sender for a new one."
            )
        return found[digest]


class RequireScope:
    """A dependency that answers the caller if the key includes a scope.

    Args:
        scope: The scope.
        shared: Whether a share link will do; it must not, unless a single job is read.
    """

    def __init__(self, scope: Scope, *, shared: bool = False) -> None:
        self.scope = scope
        self.shared = shared

    async def __call__(
        self,
        request: Request,
        key: Annotated[HTTPAuthorizationCredentials | None, Depends(BEARER)],
    ) -> Caller:
        """The caller.

        Raises:
            ProblemError: 401 or 403.
        """
        if key is None and "authorization" in request.headers:
            raise _unauthorized("The Authorization header contains no bearer key.")
        authenticator: Authenticator = request.app.state.context.authenticator
        found = await authenticator.authenticate(key.credentials if key else None)
        request.state.caller = found
        if found.shared is not None and not self.shared:
            raise ProblemError(
                403, "A share link gives access to one job only.", "Use a key for this."
            )
        if not found.has_scope(self.scope):
            raise ProblemError(
                403,
                f"The key {found.name!r} lacks the scope {self.scope}.",
                "Use another key, or ask an administrator of the service for one.",
            )
        return found


async def require_metrics_key(
    request: Request, key: Annotated[HTTPAuthorizationCredentials | None, Depends(BEARER)]
) -> None:
    """Let in whoever has `MORPH_METRICS_KEY`, or a key with the scope admin.

    Raises:
        ProblemError: 401 or 403.
    """
    secret = request.app.state.context.settings.metrics_key.get_secret_value()
    if not (secret and key and hmac.compare_digest(key.credentials.encode(), secret.encode())):
        await RequireScope("admin")(request, key)


Reader = Annotated[Caller, Depends(RequireScope("read"))]
JobReader = Annotated[Caller, Depends(RequireScope("read", shared=True))]
Submitter = Annotated[Caller, Depends(RequireScope("submit"))]
Admin = Annotated[Caller, Depends(RequireScope("admin"))]


class AuthenticatedRoute(APIRoute):
    """A route that knows its caller before it reads a body.

    FastAPI reads and parses the body first, and then asks what a route depends on.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The handler of a request."""
        handle = super().get_route_handler()
        requirements = list(_requirements(self.dependant))

        async def handle_authenticated(request: Request) -> Response:
            for requirement in requirements:
                await requirement(request, await BEARER(request))
            return await handle(request)

        return handle_authenticated


def _requirements(dependant: Dependant) -> Iterator[RequireScope]:
    for inner in dependant.dependencies:
        if isinstance(inner.call, RequireScope):
            yield inner.call
        yield from _requirements(inner)


def key_revoked() -> ProblemError:
    """A key is not known, or not any more."""
    return _unauthorized("This key is unknown or revoked.")


def _unauthorized(
    detail: str,
    remedy: str = "Send it as `Authorization: Bearer <key>`; `morph keys create` makes one.",
) -> ProblemError:
    return ProblemError(401, detail, remedy, headers={"WWW-Authenticate": "Bearer"})
