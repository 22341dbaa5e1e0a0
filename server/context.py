"""What the endpoints share: settings, files, queue, tables, event streams."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import anyio
import sqlalchemy as sa
from anyio import CapacityLimiter
from fastapi import Depends, Request

from chamfer_morph.server.auth import Authenticator, is_loopback
from chamfer_morph.server.database import tables
from chamfer_morph.server.database.api_keys import ApiKeyStore
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.database.meshes import MeshStore
from chamfer_morph.server.database.reservations import Reservations
from chamfer_morph.server.database.share_links import ShareLinkStore
from chamfer_morph.server.database.sweeps import SweepStore
from chamfer_morph.server.event_hub import EventHub
from chamfer_morph.server.failure_counts import FailureCounts
from chamfer_morph.server.mesh_locks import MeshLocks
from chamfer_morph.server.quotas import Quotas
from chamfer_morph.server.single_flight import SingleFlight
from chamfer_morph.server.store_watch import StoreWatch
from chamfer_morph.server.turns import Turns
from chamfer_morph.worker.adoptions import Adoptions
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.frame_reader import Colors
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.retention.abandoned_uploads import (
    ABANDONED_SECONDS,
    delete_abandoned_uploads,
)
from chamfer_morph.worker.retention.deletions import Deletions
from chamfer_morph.worker.retention.job_sizes import JobSizes
from chamfer_morph.worker.retention.steady_clock import clock_of
from chamfer_morph.worker.sandbox.budget import Budget
from chamfer_morph.worker.sandbox.computations import SampledShape, Sandbox
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.slots import WorkerSlots
from chamfer_morph.worker.storage import Storage, open_storage
from chamfer_morph.worker.webhooks.webhooks import Webhooks

log: logging.Logger = logging.getLogger(__name__)

Result = TypeVar("Result")

INSPECTIONS = 2
"""Meshes of a key that are parsed at the same time: both shapes of a job."""

PREVIEW_CACHE_BYTES = COLORS_CACHE_BYTES = 64 << 20

COMPUTATIONS = 1
"""Fields, thumbnails, meshes and the like computed at the same time, in this process."""


class ServerContext:
    """Everything an endpoint may need; one for each application.

    To make one connects, and creates what is missing in the database and the data directory.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings: Settings = settings
        self.storage: Storage = open_storage(settings, "api")
        self.store_is_away_until: float = float("-inf")
        self.store_watch: StoreWatch = StoreWatch(self.storage.probe_store)
        self.queue: JobQueue = JobQueue(settings)
        self.queue.migrate()
        self.engine: sa.Engine = database(settings)
        tables.create(self.engine)
        self.api_keys: ApiKeyStore = ApiKeyStore(self.engine)
        self.share_links: ShareLinkStore = ShareLinkStore(self.engine)
        self.authenticator: Authenticator = Authenticator(
            self.api_keys, self.share_links, open_without_keys=is_loopback(settings.host)
        )
        self.meshes: MeshStore = MeshStore(self.engine)
        self.mesh_locks: MeshLocks = MeshLocks(settings)
        self.adoptions: Adoptions = Adoptions(self.engine)
        self.worker_slots: WorkerSlots = WorkerSlots(self.engine)
        self.webhooks: Webhooks = Webhooks(self.engine)
        self.sweeps: SweepStore = SweepStore(self.engine)
        self.job_sizes: JobSizes = JobSizes(self.engine, self.queue, self.storage)
        self.deletions: Deletions = Deletions(self.engine, self.queue, self.storage)
        self._clock = clock_of(settings, self.job_sizes)
        self.quotas: Quotas = Quotas(
            settings, self.queue, self.meshes, self.job_sizes, Reservations(self.engine)
        )
        self.failures: FailureCounts = FailureCounts(self.queue)
        self.event_hub: EventHub = EventHub(
            self.queue,
            self.storage,
            self.authenticator.still_valid,
            settings.watchers,
            settings.watchers_per_key,
        )
        budget = Budget.of(settings)
        self.sandbox: Sandbox = Sandbox(settings, self.storage, budget)
        turns = Turns(budget)
        reading, writing = self.sandbox.reading_bytes, self.sandbox.writing_bytes
        self.inspections: SingleFlight[dict[str, Any]] = SingleFlight(
            turns.kind(reading, at_once=INSPECTIONS)
        )
        self.previews: SingleFlight[SampledShape] = SingleFlight(
            turns.kind(reading),
            cache_bytes=PREVIEW_CACHE_BYTES,
            size_of=lambda shape: shape.positions.nbytes,
        )
        self.surfaces: SingleFlight[None] = SingleFlight(turns.kind(writing, long=True))
        self.colors: SingleFlight[Colors | None] = SingleFlight(
            turns.kind(writing),
            cache_bytes=COLORS_CACHE_BYTES,
            size_of=lambda colors: colors.rgb.nbytes if colors else 1,
        )
        self.partial_results: SingleFlight[None] = SingleFlight(turns.kind(writing, long=True))
        self.exports: SingleFlight[None] = SingleFlight(turns.kind(writing, long=True))
        self._compute_limiter = CapacityLimiter(COMPUTATIONS)
        self.thumbnails: SingleFlight[bytes] = SingleFlight(lambda owner: self._compute_limiter)

    def is_revoked(self, caller: Caller) -> bool:
        """Whether the key of a caller has been revoked since it was let in.

        To be asked after making what ends with the key: whoever revokes it deletes that afterwards.
        """
        return bool(caller.digest) and not self.api_keys.has(caller.digest)

    async def compute(self, function: Callable[..., Result], *args: Any) -> Result:
        """Call a function that takes a while in a thread, when its turn has come."""
        return await anyio.to_thread.run_sync(function, *args, limiter=self._compute_limiter)

    async def keep_uploads_tidy(self) -> None:
        """Delete uploads of APIs of this machine that were killed, now and every hour, for ever.

        No janitor sees them where machines share no folder.
        """
        while True:
            try:
                await anyio.to_thread.run_sync(self._delete_abandoned_uploads)
            except Exception:  # the disk refuses: try again
                log.exception("interrupted uploads could not be deleted")
            await anyio.sleep(ABANDONED_SECONDS)

    def _delete_abandoned_uploads(self) -> None:
        if self._clock.is_steady():
            delete_abandoned_uploads(self.storage)

    def cancel_computations(self, job_id: str) -> None:
        """End what is being computed from the frames of a job, which go."""
        for computations in self._of_jobs:
            computations.cancel(job_id)

    def close_computations(self) -> None:
        """End what is being computed."""
        for computations in (*self._of_jobs, self.inspections, self.previews):
            computations.close()

    def close(self) -> None:
        """Give the connections back."""
        self.queue.close()
        self.mesh_locks.close()
        self.engine.dispose()

    @property
    def _of_jobs(self) -> tuple[SingleFlight[Any], ...]:
        """What is computed from frames, by keys that begin with the id of the job."""
        return self.surfaces, self.colors, self.thumbnails, self.partial_results, self.exports


async def _context(request: Request) -> ServerContext:
    context: ServerContext = request.app.state.context
    return context


Context = Annotated[ServerContext, Depends(_context)]
