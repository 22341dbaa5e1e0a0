"""Worker slots."""

from __future__ import annotations

from pydantic import BaseModel, Field


class WorkerStatus(BaseModel):
    """A worker slot."""

    id: str = Field(description="host-slotN")
    alive: bool
    paused: bool
    job: str | None = Field(description="The job that it is computing.")
