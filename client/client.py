"""The service from Python: `MorphClient` blocks, `AsyncMorphClient` awaits; both do the same."""

from __future__ import annotations

import os
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from functools import wraps
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

from chamfer_morph.client.connection import AsyncTransport, BlockingTransport, finish, iterate
from chamfer_morph.client.errors import ServiceError
from chamfer_morph.client.operations import Service

P = ParamSpec("P")
T = TypeVar("T")

DEFAULT_SERVER = "http://127.0.0.1:8000"
DEFAULT_TIMEOUT_SECONDS = 30.0


class AsyncMorphClient(Service):
    """The service, for use in an event loop.

        async with AsyncMorphClient() as client:
            job = await client.submit("sphere", "bunny.obj", frames=20)
            async for event in client.events(job.id):
                print(event.type, event.data)

    Args:
        server: Its address; MORPH_SERVER, or else this machine, if None.
        key: API key; MORPH_KEY, or else no key, if None.
        timeout_seconds: How long an answer may take [s].
    """

    def __init__(
        self,
        server: str | None = None,
        *,
        key: str | None = None,
        timeout_seconds: float = DEFAULT_TIMEOUT_SECONDS,
    ) -> None:
        address, options = _connection(server, key, timeout_seconds)
        super().__init__(AsyncTransport(address, **options))

    async def __aenter__(self) -> AsyncMorphClient:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()


def _blocking(
    method: Callable[Concatenate[Service, P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate[MorphClient, P], T]:
    @wraps(method)
    def call(client: MorphClient, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return finish(method(client.service, *args, **kwargs))

    return call


def _iterating(
    method: Callable[Concatenate[Service, P], AsyncGenerator[T, None]],
) -> Callable[Concatenate[MorphClient, P], Iterator[T]]:
    @wraps(method)
    def call(client: MorphClient, /, *args: P.args, **kwargs: P.kwargs) -> Iterator[T]:
        return iterate(method(client.service, *args, **kwargs))

    return call


class MorphClient:
    """The service, blocking.

        with MorphClient() as client:
            job = client.submit("sphere", "bunny.obj", frames=20)
            if client.wait(job.id).state == "succeeded":
                client.download(job.id, "sphere-to-bunny.vtkhdf")

    Args:
        server: Its address; MORPH_SERVER, or else this machine, if None.
        key: API key; MORPH_KEY, or else no key, if None.
        timeout_seconds: How long an answer may take [s].
    """

    def __init__(
        self,
        server: str | None = None,
        *,
        key: str | None = None,
        timeout_seconds: float = DEFAULT_TIMEOUT_SECONDS,
    ) -> None:
        address, options = _connection(server, key, timeout_seconds)
        self.service = Service(BlockingTransport(address, **options))

    def __enter__(self) -> MorphClient:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    close = _blocking(Service.close)

    upload_mesh = _blocking(Service.upload_mesh)
    meshes = _iterating(Service.meshes)
    mesh = _blocking(Service.mesh)
    delete_mesh = _blocking(Service.delete_mesh)

    submit = _blocking(Service.submit)
    jobs = _iterating(Service.jobs)
    job = _blocking(Service.job)
    cancel = _blocking(Service.cancel)
    resume = _blocking(Service.resume)
    retry = _blocking(Service.retry)
    delete = _blocking(Service.delete)
    events = _iterating(Service.events)
    wait = _blocking(Service.wait)

    download = _blocking(Service.download)
    frame = _blocking(Service.frame)
    source = _blocking(Service.source)
    target = _blocking(Service.target)
    field = _blocking(Service.field)
    surface = _blocking(Service.surface)
    thumbnail = _blocking(Service.thumbnail)
    export = _blocking(Service.export)
    metrics = _blocking(Service.metrics)
    config = _blocking(Service.config)
    log = _blocking(Service.log)

    sweep = _blocking(Service.sweep)
    sweep_status = _blocking(Service.sweep_status)

    presets = _blocking(Service.presets)
    methods = _blocking(Service.methods)
    shapes = _blocking(Service.shapes)
    particles = _blocking(Service.particles)
    fields = _blocking(Service.fields)
    export_formats = _blocking(Service.export_formats)

    keys = _blocking(Service.keys)
    create_key = _blocking(Service.create_key)
    delete_key = _blocking(Service.delete_key)
    workers = _blocking(Service.workers)
    pause_worker = _blocking(Service.pause_worker)
    unpause_worker = _blocking(Service.unpause_worker)


def _connection(
    server: str | None, key: str | None, timeout_seconds: float
) -> tuple[str, dict[str, Any]]:
    """Address and options of a transport."""
    address = (server or os.environ.get("MORPH_SERVER") or DEFAULT_SERVER).rstrip("/")
    secret = key or os.environ.get("MORPH_KEY") or ""
    if not address.startswith(("http://", "https://")):
        raise ServiceError(
            f"{address} is not the address of a service.", "Write it as http://127.0.0.1:8000.", 400
        )
    if not (secret.isascii() and secret.isprintable()):
        raise ServiceError("The API key has characters that no key has.", "Copy it again.", 401)
    headers = {"Authorization": f"Bearer {secret}"} if secret else {}
    return address, {"headers": headers, "timeout": timeout_seconds}


__all__ = ["AsyncMorphClient", "MorphClient", "ServiceError"]
