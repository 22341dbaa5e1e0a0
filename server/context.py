"""What the endpoints share: settings, files, queue, tables, event streams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import anyio
import sqlalchemy as sa
from fastapi import Depends, Request

from chamfer_morph.server.database import tables
from chamfer_morph.server.database.api_keys import ApiKeyStore
from chamfer_morph.server.database.meshes import MeshStore
from chamfer_morph.server.database.sweeps import SweepStore
from chamfer_morph.server.event_hub import EventHub
from chamfer_morph.server.export_tasks import ExportTasks
from chamfer_morph.server.previews import Previews
from chamfer_morph.server.quotas import Quotas
from chamfer_morph.server.single_flight import Derivations
from chamfer_morph.worker.queue import JobQueue, database
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import Storage

INSPECTIONS = 2
PREVIEWS = 1
"""Meshes parsed, and shapes filled for a preview, at the same time; each may take the memory of
`inspect_memory_bytes`."""

COMPUTATIONS = 1
"""Fields, thumbnails, meshes and the like computed at the same time, in this process."""

SURFACES = 1
EXPORTS = 1
"""Surfaces and exports made at the same time; each may take the memory of `export_memory_bytes`."""


@dataclass(frozen=True)
class ServerContext:
    """Everything an endpoint may need; one for each application."""

    settings: Settings
    storage: Storage
    queue: JobQueue
    engine: sa.Engine
    api_keys: ApiKeyStore
    meshes: MeshStore
    sweeps: SweepStore
    quotas: Quotas
    event_hub: EventHub
    inspection_limiter: anyio.CapacityLimiter
    compute_limiter: anyio.CapacityLimiter
    previews: Previews
    surfaces: Derivations
    exports: ExportTasks

    @classmethod
    def open(cls, settings: Settings) -> ServerContext:
        """Connect, and create what is missing in the database and the data directory."""
        storage = Storage(settings.data_dir)
        queue = JobQueue(settings)
        queue.migrate()
        engine = database(settings)
        tables.create(engine)
        meshes = MeshStore(engine)
        return cls(
            settings=settings,
            storage=storage,
            queue=queue,
            engine=engine,
            api_keys=ApiKeyStore(engine),
            meshes=meshes,
            sweeps=SweepStore(engine),
            quotas=Quotas(settings, storage, queue, meshes),
            event_hub=EventHub(queue, storage, settings.watchers),
            inspection_limiter=anyio.CapacityLimiter(INSPECTIONS),
            compute_limiter=anyio.CapacityLimiter(COMPUTATIONS),
            previews=Previews(settings, PREVIEWS),
            surfaces=Derivations(SURFACES),
            exports=ExportTasks(EXPORTS),
        )

    def cancel_computations(self, job_id: str) -> None:
        """End what is being computed from the frames of a job, which go."""
        folder = self.storage.derived_dir(job_id)
        self.surfaces.end(folder)
        self.exports.end(folder)

    def close_pools(self) -> None:
        """End what is being computed."""
        self.surfaces.close()
        self.exports.close()

    def close(self) -> None:
        """Give the connections back."""
        self.queue.close()
        self.engine.dispose()


async def _context(request: Request) -> ServerContext:
    context: ServerContext = request.app.state.context
    return context


Context = Annotated[ServerContext, Depends(_context)]
