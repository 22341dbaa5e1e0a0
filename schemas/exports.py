"""Exports of results."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from chamfer_morph.schemas.problems import Problem
from chamfer_morph.schemas.types import Easing, Repeat, Request, Units


def _is_none(value: object) -> bool:
    return value is None


Look = Literal["clay", "porcelain", "jelly", "metal", "wax", "glass"]
"""What things look to be made of; the same names in the page, the command line and here."""

Pixels = Annotated[int, Field(ge=16, le=4096, multiple_of=2)]


class CameraKey(Request):
    """Where the eye is at a moment; it looks at the middle of what is shown."""

    share: float = Field(ge=0, le=1, description="Of the video, from 0 to 1.")
    azimuth: float = Field(
        25.0, ge=-3600, le=3600, description="Turn about the upward axis [degrees]."
    )
    elevation: float = Field(15.0, ge=-90, le=90, description="Height above the horizon [degrees].")
    zoom: float = Field(
        1.0, ge=0.1, le=100, description="How many times larger than where all is in sight."
    )


class PictureOptions(Request):
    """How a video or its pictures are drawn."""

    width: Pixels = Field(960, description="Pixels, an even number.")
    height: Pixels = Field(720, description="Pixels, an even number.")
    look: Look | None = Field(
        None, description="What things look to be made of; plain matter under one lamp if absent."
    )
    background: str = Field(
        "white",
        max_length=40,
        description="A name, #rrggbb, or `transparent` for png, webm and mov.",
    )
    camera: Literal["still", "turn", "orbit"] = Field(
        "still",
        description="The eye rests, goes around once, or goes around, up and down on the way.",
    )
    camera_keys: list[CameraKey] = Field(
        default_factory=list,
        max_length=100,
        description="Places that the eye goes through smoothly, in place of that.",
    )


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
    texture: int | None = Field(
        None,
        ge=64,
        le=4096,
        description="Edge of the picture that holds the colours of a tracked GLB [pixels]; they "
        "are at its corners by default.",
        exclude_if=_is_none,
    )
    fps: float | None = Field(
        None, ge=1, le=120, description="Frames per second: 24, or 12 in videos, by default."
    )
    seconds: float | None = Field(
        None,
        gt=0,
        le=3600,
        description="Duration of what is played, with its rests: a video, a tracked GLB or HTML. "
        "All frames are shown, and what lies between them; `fps` is 30 then by default.",
        exclude_if=_is_none,
    )
    hold: float | None = Field(
        None, ge=0, le=600, description="Rest at each shape [s].", exclude_if=_is_none
    )
    easing: Easing | None = Field(
        None,
        description="Pace between two shapes: `linear` is even; `in-out`, which is usual, slow at "
        "both; `overshoot` goes past the end and returns.",
        exclude_if=_is_none,
    )
    repeat: Repeat | None = Field(
        None,
        description="`loop` ends as it begins, for jobs that come back to their first shape; "
        "`ping-pong` plays to the end and back.",
        exclude_if=_is_none,
    )
    picture: PictureOptions | None = Field(
        None, description="How videos and pictures are drawn.", exclude_if=_is_none
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
