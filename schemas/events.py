"""What happens to a job."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, Field

from chamfer_morph.schemas.jobs import JobState


class Event(BaseModel):
    """Something that happened to a job; the same over SSE and by polling."""

    id: int = Field(description="Ascending within a job; pass the last one to resume after it.")
    type: Literal["attempt", "stage", "frame", "watchdog", "problem", "state"]
    at: datetime
    data: dict[str, Any]


class EventPage(BaseModel):
    """Events after a given id, the oldest first."""

    items: list[Event]
    last_id: int = Field(description="Pass as `after` next time.")
    state: JobState
