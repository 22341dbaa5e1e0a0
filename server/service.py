"""What the endpoints share: settings, files, queue, tables, watched jobs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import anyio
import sqlalchemy as sa
from fastapi import Depends, Request

from server import tables
from server.keyring import Keyring
from server.limits import Limits
from server.mesh_store import MeshStore
from server.sweep_store import SweepStore
from server.watch import Watches
from worker.queue import JobQueue, database
from worker.settings import Settings
from worker.storage import Storage

INSPECTIONS = 2
"""Meshes parsed at the same time; each may take the memory of `inspect_memory_bytes`."""


@dataclass(frozen=True)
class Service:
    """Everything an endpoint may need; one for each application."""

    settings: Settings
    storage: Storage
    queue: JobQueue
    engine: sa.Engine
    keyring: Keyring
    meshes: MeshStore
    sweeps: SweepStore
    limits: Limits
    watches: Watches
    inspections: anyio.CapacityLimiter

    @classmethod
    def open(cls, settings: Settings) -> Service:
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
            keyring=Keyring(engine),
            meshes=meshes,
            sweeps=SweepStore(engine),
            limits=Limits(settings, storage, queue, meshes),
            watches=Watches(queue, storage, settings.watchers),
            inspections=anyio.CapacityLimiter(INSPECTIONS),
        )

    def close(self) -> None:
        """Give the connections back."""
        self.queue.close()
        self.engine.dispose()


async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


Services = Annotated[Service, Depends(_service)]
