"""The queued jobs of a key."""

from __future__ import annotations

from pydantic import BaseModel, Field


class QueueStatus(BaseModel):
    """The queue of a key."""

    owner: str = Field(description="Name of the key; empty without keys.")
    paused: bool = Field(description="Whether starting jobs is paused.")
    queued: int
    running: int
