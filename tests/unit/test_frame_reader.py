"""Frames of a job, wherever they are: in the run directory, in the result file, or in both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from chamfer_morph.worker.frame_reader import (
    count_frames,
    has_unsaved_frames,
    read_det_f,
    read_frame,
    read_run_record,
)
from morph_engine.errors import ResultError
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import write_result

POINTS = np.random.default_rng(3).normal(size=(50, 3)).astype(np.float32)
RUN = RunRecord(configure("fast"), POINTS, POINTS, POINTS, POINTS)


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """Where the result of a job is to be."""
    return tmp_path / "result.vtkhdf"


def append(spool: Spool, frames: int) -> None:
    """Finish some frames more; all particles of frame i have moved by i, and det F is i."""
    for index in range(spool.frame_count, spool.frame_count + frames):
        spool.append(index, POINTS + np.float32(index), {}, (), np.full(50, index, np.float32))


def require_frames(result: Path, count: int) -> None:
    """Just so many frames can be read, the last by a negative index, too."""
    assert count_frames(result) == count
    for index in range(count):
        for asked in (index, index - count):
            frame = read_frame(result, asked)
            assert frame is not None and frame.index == index
            np.testing.assert_array_equal(frame.positions, POINTS + np.float32(index))
        det_f = read_det_f(result, index)
        assert det_f is not None and (det_f == index).all()
    assert read_frame(result, count) is None and read_frame(result, -count - 1) is None


def test_before_a_job_begins(result: Path) -> None:
    """There is nothing to read, and nothing fails."""
    require_frames(result, 0)
    assert read_run_record(result) is None and not has_unsaved_frames(result)


def test_from_the_first_frame_to_the_result(result: Path) -> None:
    """While it runs, stopped, gone on with, and when its run directory has gone."""
    with Spool.create(result, RUN) as spool:
        require_frames(result, 0)
        assert read_run_record(result) is not None
        append(spool, 2)
        require_frames(result, 2)
        assert has_unsaved_frames(result)
        write_result(spool, status="partial")
        require_frames(result, 2)
        assert not has_unsaved_frames(result)
        append(spool, 1)  # and its engine was killed
        require_frames(result, 3)
        assert has_unsaved_frames(result)
        write_result(spool, status="complete")
        spool.remove()
    require_frames(result, 3)
    assert read_run_record(result) is not None and not has_unsaved_frames(result)


def test_a_job_that_starts_over_shows_what_it_had(result: Path) -> None:
    """Until it has as many frames again."""
    with Spool.create(result, RUN) as spool:
        append(spool, 3)
        write_result(spool, status="partial")
    with Spool.create(result, RUN, replace=True) as spool:
        append(spool, 1)
        require_frames(result, 3)


def test_a_damaged_frame_is_told(result: Path) -> None:
    """The others can be read all the same."""
    with Spool.create(result, RUN) as spool:
        append(spool, 2)
        path = spool.path / "frame-000001.npz"
    path.write_bytes(path.read_bytes()[:100])
    assert read_frame(result, 0) is not None
    with pytest.raises(ResultError, match="cannot be read"):
        read_frame(result, 1)
