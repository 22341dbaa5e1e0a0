"""Memory and disk are asked for before a run starts, not found missing in the middle of it."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from morph_engine import morphing
from morph_engine.errors import ResourceError
from morph_engine.presets import configure
from morph_engine.results.spool import spool_path

CONFIG = configure("fast", {"sampling.points_per_cell_edge": 2, "frames": 40})


@pytest.fixture(scope="module")
def record():
    """A small run that any machine can hold."""
    return morphing.prepare("sphere", "star", CONFIG)


def test_a_run_that_fits_is_let_through(record, tmp_path):
    """No complaint where there is memory and disk."""
    morphing.check_resources(record, tmp_path / "result.vtkhdf")


def test_too_little_memory_is_refused_before_the_run(record, monkeypatch, tmp_path):
    """The message says how much is needed, how much is free, and which option to lower."""
    monkeypatch.setattr(
        morphing.psutil, "virtual_memory", lambda: SimpleNamespace(available=10_000_000)
    )
    out = tmp_path / "result.vtkhdf"
    with pytest.raises(ResourceError, match=r"10 MB are free.*points_per_cell_edge"):
        next(iter(morphing.run(record, out=out)))
    assert list(tmp_path.iterdir()) == []


def test_the_frames_of_a_long_run_take_disk_alone(record, monkeypatch, tmp_path):
    """The result is written as it is made: 16 bytes a particle and frame, and no memory."""
    long = replace(record, config=CONFIG.model_copy(update={"frames": 100_000}))
    size = 16 * record.particle_count * 100_000
    monkeypatch.setattr(morphing.psutil, "virtual_memory", lambda: SimpleNamespace(available=size))
    monkeypatch.setattr(morphing.psutil, "disk_usage", lambda path: SimpleNamespace(free=size))
    out = tmp_path / "result.vtkhdf"
    morphing.check_resources(record, out)
    morphing.check_resources(long)
    with pytest.raises(ResourceError, match="MB of disk"):
        morphing.check_resources(long, out)


def test_frames_that_are_there_take_no_more_disk(record, monkeypatch, tmp_path):
    """A run that goes on needs room for the frames to come and for the result."""
    out = tmp_path / "result.vtkhdf"
    of_a_frame = 16 * record.particle_count
    free = 10_000_000 + of_a_frame * (2 * record.planned_frames - 3)
    monkeypatch.setattr(morphing.psutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    with pytest.raises(ResourceError, match="MB of disk"):
        morphing.check_resources(record, out)
    spool_path(out).mkdir()
    for frame in range(4):
        (spool_path(out) / f"frame-{frame:06d}.npz").touch()
    morphing.check_resources(record, out)


def test_too_little_disk_is_refused_before_the_run(record, monkeypatch, tmp_path):
    """The message says how much is needed, how much is free, and what to change."""
    monkeypatch.setattr(morphing.psutil, "disk_usage", lambda path: SimpleNamespace(free=1_000_000))
    out = tmp_path / "result.vtkhdf"
    with pytest.raises(ResourceError, match=r"1 MB are free.*`out`"):
        next(iter(morphing.run(record, out=out)))
    assert list(tmp_path.iterdir()) == []
