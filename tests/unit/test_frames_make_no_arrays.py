"""What a frame needs on the device is made once, for Taichi keeps its memory to the end."""

from __future__ import annotations

import pytest
import taichi as ti

from morph_engine.morphing import prepare, run
from morph_engine.presets import configure


@pytest.mark.parametrize("method", ["flow", "transport"])
def test_frames_make_no_arrays(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those before them do, so that one would be seen."""
    made: list[ti.Ndarray] = []
    begin = ti.Ndarray.__init__

    def note(self: ti.Ndarray) -> None:
        made.append(self)
        begin(self)

    monkeypatch.setattr(ti.Ndarray, "__init__", note)
    few = {"method": method, "sampling.points_per_cell_edge": 1, "frames": 6}
    frames = run(prepare("sphere", "torus", configure(overrides=few)), device="cpu")
    next(frames)
    before = len(made)
    assert before > 10
    for _ in frames:
        assert len(made) == before
