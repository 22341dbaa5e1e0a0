"""Rows on whole frames of a morph, sphere to torus, 37 thousand particles."""

from __future__ import annotations

from itertools import islice
from statistics import median

from benchmarks.comparison import Row, limit
from morph_engine import configure, morph

Bar = tuple[float | None, float | None]

AUTHORS_FRAME = 170.0  # CPU s of the authors' program for one physics frame
WITHOUT_CHAMFER = range(1, 4)  # frame 0 compiles
WITH_CHAMFER = range(7, 10)  # the term sets in at frame 6, and compiles there

# what, preset, bar of the physics frame, bar of the joint frame: (at least, aim)
SCHEDULES: tuple[tuple[str, str, Bar, Bar], ...] = (
    ("authors' schedule", "published", (8.0, 4.0), (10.0, 5.0)),
    ("preset fast", "fast", (None, None), (None, None)),
)


def measure(quick: bool) -> list[Row]:
    """Measure CPU time of frames by the authors' schedule, and by the default preset."""
    rows = []
    for schedule, preset, physics_bar, joint_bar in SCHEDULES:
        last = WITH_CHAMFER[0] if quick else WITH_CHAMFER[-1]
        frames = islice(
            morph("sphere", "torus", configure(preset, {"method": "joint"}), device="cpu"), last + 1
        )
        seconds = [frame.cpu_seconds for frame in frames]
        note = f"the authors' program takes {AUTHORS_FRAME:.0f}" if not rows else ""
        physics = median(seconds[i] for i in WITHOUT_CHAMFER)
        joint = median(seconds[WITH_CHAMFER[0] :])
        rows.append(limit(f"physics frame, {schedule}", physics, "CPU s", *physics_bar, note))
        rows.append(limit(f"joint frame, {schedule}", joint, "CPU s", *joint_bar))
    return rows
