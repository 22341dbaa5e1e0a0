"""The queued jobs of a key."""

from __future__ import annotations

from pydantic import BaseModel, Field


class QueueStatus(BaseModel):
    """How the jobs of a key wait."""

    owner: str = Field(description="Name of the key; empty without keys.")
    paused: bool = Field(description="Whether no more of them are started.")
    queued: int
    running: int
