"""/livez, /readyz and /metrics, for whatever looks after the service."""

from __future__ import annotations

import shutil
import threading
import time
from collections import Counter as Counts
from collections.abc import Iterator
from typing import Literal, get_args

from fastapi import APIRouter, Depends, Request, Response
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.registry import Collector
from pydantic import BaseModel, Field
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chamfer_morph.schemas import Problem, WorkerStatus
from chamfer_morph.server.auth import require_metrics_key
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.problems import is_disk_full, unavailable
from chamfer_morph.server.routes.workers import worker_statuses

router: APIRouter = APIRouter(tags=["health"])

FAILURE_KINDS = get_args(Problem.model_fields["kind"].annotation)
FIGURES_SECONDS = 5.0
"""How long figures of the database are told again: however often somebody asks, it is not."""

WORKER_STATES = ("busy", "idle", "paused", "dead")


class Health(BaseModel):
    """The service answers."""

    status: Literal["ok"] = "ok"


class Readiness(BaseModel):
    """The service takes requests."""

    status: Literal["ok", "reading"] = Field(
        "ok",
        description="`reading`: jobs can be listed, shown and cancelled; requests that need files "
        "get 503.",
    )
    detail: str | None = Field(None, description="What is unavailable, if anything.")


class StoredCounter(Collector):
    """A counter that the database keeps, the same for every API process.

    Args:
        name: Its name, to which Prometheus's format adds `_total`.
        meaning: What it counts.

    Attributes:
        value: As it was read last.
    """

    def __init__(self, name: str, meaning: str) -> None:
        self._name = name
        self._meaning = meaning
        self.value: int = 0

    def collect(self) -> Iterator[CounterMetricFamily]:
        """Its one sample."""
        yield CounterMetricFamily(self._name, self._meaning, self.value)


class Metrics:
    """What Prometheus is told of."""

    def __init__(self) -> None:
        self.registry: CollectorRegistry = CollectorRegistry()
        self.requests: Counter = Counter(
            "morph_requests",
            "Requests answered.",
            ("operation", "status"),
            registry=self.registry,
        )
        self.seconds: Histogram = Histogram(
            "morph_request_seconds",
            "Time until the response begins [s].",
            ("operation",),
            registry=self.registry,
            buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.15, 0.25, 0.5, 1, 2.5, 5, 10, 30),
        )
        self.open: Gauge = Gauge(
            "morph_requests_open", "Requests in progress.", registry=self.registry
        )
        self.jobs: Gauge = Gauge("morph_jobs", "Jobs by state.", ("state",), registry=self.registry)
        self.failures: Counter = Counter(
            "morph_job_failures",
            "Jobs that have failed or timed out since this API process started, by kind "
            "of problem.",
            ("kind",),
            registry=self.registry,
        )
        self.adoptions: StoredCounter = StoredCounter(
            "morph_adoptions",
            "Times that jobs of a dead worker were put back into the queue.",
        )
        self.registry.register(self.adoptions)
        self.workers: Gauge = Gauge(
            "morph_workers",
            "Worker slots: busy, idle, paused, or dead, which died with unfinished jobs.",
            ("state",),
            registry=self.registry,
        )
        self.queue_age: Gauge = Gauge(
            "morph_queue_age_seconds",
            "Age of the longest-waiting job [s].",
            registry=self.registry,
        )
        self.disk_free: Gauge = Gauge(
            "morph_disk_free_bytes",
            "Free space for the data directory [bytes].",
            registry=self.registry,
        )
        self.streams: Gauge = Gauge(
            "morph_event_streams", "Open event streams.", registry=self.registry
        )
        self._read_at = float("-inf")
        self._one_at_a_time = threading.Lock()

    def refresh(self, context: ServerContext) -> None:
        """Read what database and disk tell, unless that was done a few seconds ago."""
        with self._one_at_a_time:
            if time.monotonic() - self._read_at < FIGURES_SECONDS:
                return
            for state, count in context.queue.counts().items():
                self.jobs.labels(state.value).set(count)
            failures = context.failures.since_last_call()
            for kind in {*FAILURE_KINDS, *failures}:
                self.failures.labels(kind).inc(failures[kind])
            self.adoptions.value = context.adoptions.total()
            workers = Counts(map(_state, worker_statuses(context)))
            for name in WORKER_STATES:
                self.workers.labels(name).set(workers[name])
            since = context.queue.waiting_since()
            self.queue_age.set(max(time.time() - since.timestamp(), 0) if since else 0)
            self.disk_free.set(shutil.disk_usage(context.storage.root).free)
            self._read_at = time.monotonic()


def _state(worker: WorkerStatus) -> str:
    """The state that a slot counts as; one that is gone and has left no job counts as none."""
    if not worker.alive:
        return "dead" if worker.job else ""
    return "busy" if worker.job else "paused" if worker.paused else "idle"


class MetricsMiddleware:
    """Counts and times every request by the operation that answers it."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self.app = app
        self.metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begun = time.perf_counter()
        answered = False

        def count(status: int) -> None:
            nonlocal answered
            answered = True
            operation = getattr(scope.get("route"), "operation_id", None) or "none"
            self.metrics.requests.labels(operation, str(status)).inc()
            self.metrics.seconds.labels(operation).observe(time.perf_counter() - begun)

        async def send_timed(message: Message) -> None:
            if message["type"] == "http.response.start":
                count(message["status"])
            await send(message)

        with self.metrics.open.track_inprogress():
            try:
                await self.app(scope, receive, send_timed)
            except Exception:  # answered by what is around this: the framework's last resort
                if not answered:
                    count(500)
                raise


@router.get("/livez", operation_id="livez", summary="Is the process alive?")
async def livez() -> Health:
    """Answers as long as the process is alive."""
    return Health()


@router.get(
    "/readyz",
    operation_id="readyz",
    summary="Can it take requests?",
    response_model_exclude_none=True,
)
def readyz(context: Context) -> Readiness:
    """Succeeds if the database answers and the data directory has free space.

    If the object store is unavailable, it says so but still counts as ready, for reading.
    """
    try:
        context.queue.ping()
        context.storage.probe()
    except Exception as error:
        if is_disk_full(error):
            raise unavailable("The disk of the service is full.", "Free some space.") from error
        if isinstance(error, OSError):
            raise unavailable(
                f"The data directory cannot be written to ({error.strerror or error}).",
                "Check that the disk of MORPH_DATA_DIR is there and writable.",
            ) from error
        raise unavailable("The database is not available at the moment.") from error
    if context.settings.object_store and (cause := context.store_watch.cause()):
        return Readiness(status="reading", detail=cause)
    return Readiness()


@router.get(
    "/metrics",
    operation_id="metrics",
    summary="Metrics for Prometheus",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
    dependencies=[Depends(require_metrics_key)],
)
def metrics(request: Request, context: Context) -> Response:
    """Requests, their times, jobs, workers and open streams, in Prometheus's text format.

    If there are keys, it needs the one in `MORPH_METRICS_KEY` or one with the scope admin.
    """
    metrics: Metrics = request.app.state.metrics
    metrics.refresh(context)
    metrics.streams.set(context.event_hub.subscribers)
    return Response(
        generate_latest(metrics.registry), headers={"Content-Type": CONTENT_TYPE_PLAIN_0_0_4}
    )
