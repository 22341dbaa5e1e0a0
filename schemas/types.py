"""Types that several schemas share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

Device = Literal["auto", "cpu", "cuda", "vulkan", "metal"]
Scope = Literal["read", "submit", "admin"]
FrameFormat = Literal["f32", "u16", "ply", "npy"]
SurfaceFormat = Literal["glb", "ply", "obj", "stl"]
Units = Literal["user", "source", "target", "grid"]
"""Coordinates: of the user's files, from the source's in the beginning to the target's at the end;
of either all the time; or grid units."""

Fit = Literal["auto", "none", "volume", "extent"]
"""How a shape is placed in the domain; `auto` scales only what needs it."""

Up = Literal["y", "z"]
"""The axis that points upwards."""

JobStage = Literal["filling", "preparing", "computing"]
"""What goes on before the first frame of an attempt."""

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Name = Annotated[str, Field(max_length=200, pattern=r"^[^\x00]*$")]


class Request(BaseModel, extra="forbid", strict=True, allow_inf_nan=False):
    """Base of request bodies: unknown fields and other types are errors."""


Easing = Literal["linear", "in-out", "overshoot"]
"""Pace between two shapes, see `ExportRequest`."""

Repeat = Literal["none", "loop", "ping-pong"]
"""How what is played ends, see `ExportRequest`."""
