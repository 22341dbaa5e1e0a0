"""Results that are played in a time of their own."""

from __future__ import annotations

from pydantic import BaseModel, Field


class Playback(BaseModel):
    """What a player shows when."""

    fps: float = Field(description="Pictures per second.")
    repeat: bool = Field(description="Whether it goes on from its beginning.")
    frames: list[float] = Field(
        description="The frame of each picture, or the place between two: 2.5 is half-way from "
        "frame 2 to frame 3. The first stands for the source, and the end of a leg for what lies "
        "beyond it."
    )
