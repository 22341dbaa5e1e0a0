"""Results that are played in a time of their own."""

from __future__ import annotations

from pydantic import BaseModel, Field


class Playback(BaseModel):
    """Which frame a player shows at each time."""

    fps: float = Field(description="Frames per second.")
    repeat: bool = Field(description="Whether it restarts at the end.")
    frames: list[float] = Field(
        description="The frame to show at each instant, or the position between two: 2.5 is "
        "half-way from frame 2 to frame 3. The first frame stands for the source, and the last "
        "frame of a leg for anything beyond it."
    )
