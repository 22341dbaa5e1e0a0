"""The API as an ASGI application."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import metadata
from typing import TYPE_CHECKING

import anyio
from fastapi import APIRouter, FastAPI
from fastapi_offline import FastAPIOffline

from chamfer_morph.server.context import ServerContext
from chamfer_morph.server.http import openapi, problems
from chamfer_morph.server.http.audit import AuditMiddleware
from chamfer_morph.server.http.local_only import LocalOnlyMiddleware
from chamfer_morph.server.http.request_body import BodyLimitMiddleware
from chamfer_morph.server.routes import (
    catalog,
    events,
    exports,
    fields,
    health,
    job_colors,
    job_shapes,
    jobs,
    keys,
    meshes,
    particles,
    playback,
    queue,
    results,
    share_links,
    surfaces,
    sweeps,
    thumbnails,
    web_page,
    webhooks,
    workers,
)
from chamfer_morph.worker import telemetry
from chamfer_morph.worker.settings import Settings

if TYPE_CHECKING:
    from fastapi.telemetry import TelemetryConfig

DESCRIPTION = """\
Morph one 3D shape into another by physics: upload meshes, submit jobs, watch them, fetch results.

Every error is an RFC 9457 problem with the cause in `detail` and how to fix it in `remedy`.
"""

ROUTERS = (
    meshes, jobs, results, job_shapes, job_colors, fields, surfaces, thumbnails, playback, exports,
    events, share_links, sweeps, catalog, particles, queue, webhooks, keys, workers,
)  # fmt: skip


def create_app(settings: Settings) -> FastAPI:
    """The application; it connects when it starts, not when it is made.

    Args:
        settings: Where to listen decides whether keys are needed, the rest is for its endpoints.
    """
    metrics = health.Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        context = await anyio.to_thread.run_sync(ServerContext, settings)
        app.state.context = context
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(context.keep_uploads_tidy)
                yield
                tasks.cancel_scope.cancel()
        finally:
            context.event_hub.close()
            context.close_computations()
            await anyio.to_thread.run_sync(context.close)
            await anyio.to_thread.run_sync(telemetry.flush)

    app = FastAPIOffline(  # /docs works without a network
        title="morph",
        version=metadata.version("chamfer-morph"),
        summary="Differentiable shape morphing as a service",
        description=DESCRIPTION,
        lifespan=lifespan,
        redirect_slashes=False,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        telemetry=_telemetry(),
    )
    app.state.metrics = metrics
    problems.install(app)
    app.add_exception_handler(404, web_page.not_found)
    app.add_middleware(
        BodyLimitMiddleware,
        timeout_seconds=settings.upload_timeout_seconds,
        deadline_seconds=settings.upload_deadline_seconds,
        max_bytes=settings.body_bytes,
        exceptions={
            "/v1/meshes": settings.upload_bytes + settings.body_bytes,
            "/v1/jobs": 2 * settings.upload_bytes + settings.body_bytes,
        },
    )
    app.add_middleware(LocalOnlyMiddleware)
    app.add_middleware(health.MetricsMiddleware, metrics)
    app.add_middleware(AuditMiddleware)
    v1 = APIRouter(prefix="/v1")
    for resource in ROUTERS:
        v1.include_router(resource.router)
    app.include_router(v1)
    app.include_router(health.router)
    app.include_router(web_page.router)
    openapi.install(app)
    return app


def _telemetry() -> TelemetryConfig:
    """A span for each request of the API, if this process is traced; probes have none."""
    provider = telemetry.provider()
    return {
        "tracing": provider is not None,
        "tracer_provider": provider,
        "exclude": lambda scope: not scope["path"].startswith("/v1/"),
        "operation_spans": False,
        "metrics": False,
        "logs": False,
        "auto_configure": False,
    }
