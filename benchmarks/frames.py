"""Rows on whole frames of a morph, sphere to torus, 37 thousand particles."""

from __future__ import annotations

from itertools import islice
from statistics import median
from typing import Any

from benchmarks.rows import Row, limit
from morph_engine import configure, morph

Bar = tuple[float | None, float | None]

AUTHORS_FRAME = 170.0  # CPU s of the authors' program for one physics frame
FROM_THE_FIRST_FRAME = {"chamfer.start_frame": 0, "chamfer.ramp_frames": 1}
SEQUENTIAL = {"optimizer.strategy": "sequential"}  # a sweep back for each of 27 control steps

# what, preset, overrides, bar of the physics frame, bar of the joint frame: (at least, aim)
SCHEDULES: tuple[tuple[str, str, dict[str, Any], Bar, Bar], ...] = (
    ("authors' schedule", "fast", SEQUENTIAL, (8.0, 4.0), (10.0, 5.0)),
    ("preset published", "published", {}, (None, None), (None, None)),
    ("preset fast", "fast", {}, (None, None), (None, None)),
)


def measure(quick: bool) -> list[Row]:
    """Measure CPU time of frames by the authors' schedule, and by two presets."""
    rows = []
    for schedule, preset, overrides, *bars in SCHEDULES:
        for method, (at_least, aim) in zip(("physics", "joint"), bars, strict=True):
            seconds = frame_cost(preset, {"method": method, **overrides}, 1 if quick else 3)
            what = f"whole {method} frame, {schedule}"
            note = f"the authors' program takes {AUTHORS_FRAME:.0f}" if not rows else ""
            rows.append(limit(what, seconds, "CPU s", at_least, aim, note))
    return rows


def frame_cost(preset: str, overrides: dict[str, Any], frame_count: int) -> float:
    """Median CPU time [s] of frames after the first, which compiles and has no Chamfer term yet."""
    config = configure(preset, overrides | FROM_THE_FIRST_FRAME)
    frames = morph("sphere", "torus", config, device="cpu")
    return median(frame.cpu_seconds for frame in islice(frames, 1, 1 + frame_count))
