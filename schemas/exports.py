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
    """A camera position at one time; the camera looks at the middle of what is shown."""

    share: float = Field(ge=0, le=1, description="Time as a share of the video, from 0 to 1.")
    azimuth: float = Field(
        25.0, ge=-3600, le=3600, description="Rotation about the upward axis [degrees]."
    )
    elevation: float = Field(15.0, ge=-90, le=90, description="Height above the horizon [degrees].")
    zoom: float = Field(
        1.0,
        ge=0.1,
        le=100,
        description="Magnification relative to the view where everything is in sight.",
    )


class PictureOptions(Request):
    """How a video or its pictures are rendered."""

    width: Pixels = Field(960, description="Pixels; an even number.")
    height: Pixels = Field(720, description="Pixels; an even number.")
    look: Look | None = Field(None, description="Material; default: plain, with simple lighting.")
    background: str = Field(
        "white",
        max_length=40,
        description="A name, #rrggbb, or `transparent` for png, webm and mov.",
    )
    camera: Literal["still", "turn", "orbit"] = Field(
        "still",
        description="The camera stays still, circles once, or circles while moving up and down.",
    )
    camera_keys: list[CameraKey] = Field(
        default_factory=list,
        max_length=100,
        description="Positions for a smooth camera path, instead of `camera`.",
    )


class ExportRequest(Request):
    """Frames to write in another format."""

    format: str = Field(max_length=40, description="Name of a format, see /v1/exports/formats.")
    frames: list[int] | None = Field(
        None,
        min_length=1,
        max_length=10000,
        description="Indices from 0, negative from the end; default: all.",
    )
    surface: bool = Field(
        False, description="A surface around the particles, instead of the particles."
    )
    snap: bool = Field(
        False,
        description="Snap the surface of the first and last frames onto the meshes of both shapes.",
    )
    tracked: bool = Field(
        False,
        description="One mesh with the same triangles in all frames, animated in one file; for "
        "formats that carry `tracked`.",
    )
    texture: int | None = Field(
        None,
        ge=64,
        le=4096,
        description="Width of a square texture with the colours of a tracked GLB [pixels]; "
        "default: colours at the vertices.",
        exclude_if=_is_none,
    )
    fps: float | None = Field(
        None, ge=1, le=120, description="Frames per second; default: 24, or 12 for videos."
    )
    seconds: float | None = Field(
        None,
        gt=0,
        le=3600,
        description="Playing time including pauses [s], for a video, a tracked GLB or HTML. All "
        "frames are shown, with interpolation between them; the default of `fps` is then "
        "30.",
        exclude_if=_is_none,
    )
    hold: float | None = Field(
        None, ge=0, le=600, description="Pause at each shape [s].", exclude_if=_is_none
    )
    easing: Easing | None = Field(
        None,
        description="Pace between two shapes: `linear` is even; `in-out`, the default, is slow at "
        "both; `overshoot` goes past the end and returns.",
        exclude_if=_is_none,
    )
    repeat: Repeat | None = Field(
        None,
        description="`loop` ends as it begins, for jobs that return to their first shape; "
        "`ping-pong` plays to the end and back.",
        exclude_if=_is_none,
    )
    picture: PictureOptions | None = Field(
        None, description="How videos and pictures are rendered.", exclude_if=_is_none
    )
    units: Units = Field(
        "user",
        description="Coordinates: `user`, those of the source file at the start and of the target "
        "file at the end; `source` or `target`, those of that file throughout; or `grid` "
        "units.",
    )
    fields: list[str] = Field(
        default_factory=list, max_length=20, description="Fields to include, see /v1/fields."
    )


class Export(BaseModel):
    """An export of a job."""

    id: str
    job: str
    state: Literal["running", "ready", "failed"]
    progress: float = Field(description="Completed share, from 0 to 1.")
    problem: Problem | None = Field(description="Set once it has failed.")
    file_name: str | None = Field(description="Set once it is ready.")
    size: int | None = Field(description="Set once it is ready [bytes].")
    links: dict[str, str] = Field(description="`self`, and `file` once it is ready.")
