"""Where a run computes."""

from typing import Literal

Device = Literal["auto", "cpu", "cuda", "vulkan", "metal"]
"""A kind of processor; `auto` takes the fastest that there is."""
