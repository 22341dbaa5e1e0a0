"""Exports of results."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from chamfer_morph.schemas.problems import Problem
from chamfer_morph.schemas.types import Request, Units


class ExportRequest(Request):
    """Frames to write in another format."""

    format: str = Field(max_length=40, description="Name of a format, see /v1/exports/formats.")
    frames: list[int] | None = Field(
        None, min_length=1, max_length=10000, description="0-based, negative from the end; or all."
    )
    surface: bool = Field(False, description="A surface around the particles in their place.")
    snap: bool = Field(
        False,
        description="Draw the surface of the first and last frames to the meshes of both shapes.",
    )
    tracked: bool = Field(
        False,
        description="One mesh through all frames, whose triangles stay the same, animated in one "
        "file; for formats that carry `tracked`.",
    )
    fps: float | None = Field(
        None, ge=1, le=120, description="Frames per second: 24, or 12 in videos, by default."
    )
    units: Units = Field(
        "user",
        description="Coordinates: `user`, of the source's file in the beginning and the target's "
        "at the end; `source` or `target`, of that file all the time; or `grid` units.",
    )
    fields: list[str] = Field(
        default_factory=list, max_length=20, description="To carry along, see /v1/fields."
    )


class Export(BaseModel):
    """An export of a job."""

    id: str
    job: str
    state: Literal["running", "ready", "failed"]
    progress: float = Field(description="Share that is done, 0 to 1.")
    problem: Problem | None = Field(description="Once it has failed.")
    file_name: str | None = Field(description="Once it is ready.")
    size: int | None = Field(description="Once it is ready [bytes].")
    links: dict[str, str] = Field(description="`self`, and `file` once it is ready.")
