"""Frames are written while the next ones are computed, and those that come are on the disk."""

from pathlib import Path

import numpy as np
import pytest

from morph_engine import Trajectory, configure, morph
from morph_engine.errors import SimulationError
from morph_engine.methods.flow import Flow
from morph_engine.results.spool import Spool, finished_frames

CONFIG = configure(overrides={"sampling.points_per_cell_edge": 1, "frames": 5})


def test_a_frame_that_comes_is_on_the_disk_with_its_state(tmp_path: Path) -> None:
    """And the state that lies there is the one after it, so that it can be kept."""
    out = tmp_path / "a.vtkhdf"
    for frame in morph("sphere", "star", CONFIG, out=out):
        assert finished_frames(out) >= frame.index + 1
        with Spool.open(out, writable=False) as spool:
            checkpoint = spool.load_checkpoint()
            np.testing.assert_array_equal(spool.positions(frame.index), frame.positions)
        assert checkpoint is not None
        assert checkpoint.frame == frame.index
        np.testing.assert_array_equal(checkpoint.arrays["x"], frame.positions)


def test_frames_before_one_that_fails_come_and_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also the last one, which is still being written by then."""
    advance = Flow.advance

    def failing(method: Flow, frame: int):
        if frame == 3:
            raise SimulationError("There is no going on.", "Turn back.")
        return advance(method, frame)

    monkeypatch.setattr(Flow, "advance", failing)
    out, came = tmp_path / "a.vtkhdf", []
    with pytest.raises(SimulationError, match="no going on"):
        for frame in morph("sphere", "star", CONFIG, out=out):
            came.append(frame.index)
    assert came == [0, 1, 2]
    with Trajectory(out) as result:
        assert result.status == "partial"
        assert len(result) == 3
