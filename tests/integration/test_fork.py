"""A run that begins with frames of another and goes on with other settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from morph_engine import configure, methods
from morph_engine.config import setting_fields
from morph_engine.errors import ConfigError
from morph_engine.morphing import Frame, morph, prepare, run
from morph_engine.results.fork import begin_fork, forked_config
from morph_engine.results.spool import Checkpoint, Spool, checkpoint_path, read_checkpoint
from morph_engine.results.trajectory import Trajectory

FRAMES, COMMON = 4, 1
CHANGES = {
    "flow": {"material.youngs_modulus": 1},
    "joint": {"material.youngs_modulus": 30000, "frames": FRAMES + 1},
    "dco": {"descent.learning_rate": 0.001},
}


@pytest.fixture(params=CHANGES)
def original(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Checkpoint]:
    """The result of a small run, and its state after the frame in common."""
    settings = {"method": request.param, "frames": FRAMES, "sampling.points_per_cell_edge": 1}
    out = tmp_path / "original.vtkhdf"
    state = None
    for frame in morph("sphere", "star", configure("fast", settings), device="cpu", out=out):
        if frame.index == COMMON:
            state = read_checkpoint(checkpoint_path(out))
    assert state
    return out, state


def fork(original: Path, state: Checkpoint, changes: dict[str, object]) -> list[Frame]:
    """All frames of a fork."""
    with Trajectory(original) as result:
        config = forked_config(result.config, changes, state.frame)
    out = original.with_name("fork.vtkhdf")
    begin_fork(original, state, config, out)
    with Spool.open(out, writable=False) as spool:
        record = spool.run
    return list(run(record, device="cpu", out=out, resume=True))


def test_with_the_same_settings_it_is_the_original(original: tuple[Path, Checkpoint]) -> None:
    """To the last bit; with others it is so up to the frame in common, and not from there on."""
    out, state = original
    with Trajectory(out) as result:
        positions, events, method = list(result), result.events, result.config.method.name
        metrics = [result.metrics_at(index) for index in range(FRAMES)]
    same = fork(out, state, {})
    np.testing.assert_array_equal([frame.positions for frame in same], positions)
    assert [frame.metrics for frame in same] == metrics
    assert [event.document() for frame in same for event in frame.events] == events
    changed = fork(out, state, CHANGES[method])
    assert len(changed) == CHANGES[method].get("frames", FRAMES)
    for index, before in enumerate(positions):
        equal = np.array_equal(changed[index].positions, before)
        assert equal == (index <= COMMON), index


@pytest.mark.parametrize(
    ("method", "changes", "words"),
    [
        ("joint", {"method": "flow"}, "cannot change method"),
        ("joint", {"grid.dx": 2}, "cannot change grid"),
        ("joint", {"points_per_cell_edge": 2}, "no setting called"),
        ("joint", {"sampling.points_per_cell_edge": 2}, "cannot change sampling"),
        ("joint", {"placement.target.scale": 2}, "cannot change placement"),
        ("joint", {"seed": 7}, "cannot change seed"),
        ("joint", {"frames": 5}, "none of the 5 frames is left"),
        ("joint", {"chamfer.weight": -1}, "chamfer.weight"),
        ("flow", {"frames": 80}, "cannot change frames"),
        ("flow", {"like_parts": "on"}, "cannot change like_parts"),
        ("transport", {"rest": 0.2}, "cannot change rest"),
    ],
)
def test_what_makes_no_sense_is_refused(
    method: str, changes: dict[str, object], words: str
) -> None:
    """With the cause."""
    with pytest.raises(ConfigError, match=words):
        forked_config(configure("fast", {"method": method, "frames": 9}), changes, 4)


def test_what_methods_keep_are_settings() -> None:
    """Each is one that the method has."""
    for name in methods.names():
        assert set(methods.options_of(name).fixed) <= setting_fields(name).keys(), name


def test_a_fork_of_a_fork_and_of_an_unfinished_run(tmp_path: Path) -> None:
    """Both begin with the run directory; damage is told."""
    config = configure("fast", {"method": "dco", "frames": 3, "sampling.points_per_cell_edge": 1})
    record, out = prepare("sphere", "star", config), tmp_path / "a.vtkhdf"
    frames = run(record, device="cpu", out=out)
    first = next(frames)
    state = read_checkpoint(checkpoint_path(out))
    again, last = tmp_path / "b.vtkhdf", tmp_path / "c.vtkhdf"
    begin_fork(out, state, config, again)
    begin_fork(again, read_checkpoint(checkpoint_path(again)), config, last)
    with Spool.open(last, writable=False) as spool:
        np.testing.assert_array_equal(spool.positions(0), first.positions)
        found = spool.load_checkpoint()
    assert found and found.frame == 0
    frames.close()
