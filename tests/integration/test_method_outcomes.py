"""What a method returns stays its own, and is looked at before it is stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from morph_engine import Trajectory, configure, morph
from morph_engine.errors import SimulationError
from morph_engine.methods import FrameOutcome, Method
from morph_engine.methods.flow import Flow

CONFIG = configure(overrides={"sampling.points_per_cell_edge": 1, "frames": 6})


def outcome(method: Method[Any], positions: np.ndarray) -> FrameOutcome:
    """One that is as it should be."""
    target = method.problem.target
    d_fwd, nearest = cKDTree(target).query(positions)
    d_rev, _ = cKDTree(positions).query(target)
    return FrameOutcome(positions, d_fwd, nearest.astype(np.int32), d_rev)


def test_a_method_may_move_its_particles_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames that came before stay as they were, in memory and in the file."""
    held: list[np.ndarray] = []

    def advance(method: Flow, _frame: int) -> FrameOutcome:
        if not held:
            held.append(method.problem.source.copy())
        held[0][:] += np.float32(0.25)
        return outcome(method, held[0])

    monkeypatch.setattr(Flow, "advance", advance)
    out = tmp_path / "a.vtkhdf"
    frames = list(morph("sphere", "star", CONFIG, out=out))
    with Trajectory(out) as stored:
        assert stored.frame_count == 6
        for i, frame in enumerate(frames):
            np.testing.assert_array_equal(stored.positions(i), frame.positions)
            moved = frame.positions - stored.run.source_points
            assert moved == pytest.approx(np.full_like(moved, 0.25 * (i + 1)), abs=1e-5)
            assert frame.metrics["max_move"] == pytest.approx(0.25 * np.sqrt(3), abs=1e-5)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda o: replace(o, positions=o.positions[1:]), r"positions of shape \(\d+, 3\), not"),
        (lambda o: replace(o, d_rev=o.d_rev[:-3]), r"d_rev of shape \(\d+,\), not"),
        (lambda o: replace(o, nearest_fwd=o.nearest_fwd + 10**6), "none of a target point"),
        (lambda o: replace(o, deformation=np.ones((5, 3, 3))), r"deformation of shape \(5, 3, 3\)"),
        (lambda _: None, "a NoneType, not a FrameOutcome"),
    ],
)
def test_what_is_no_outcome_is_told_with_the_name_of_the_method(
    change: Callable[[FrameOutcome], Any],
    cause: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is not measured; frames before it are kept."""

    def advance(method: Flow, frame: int) -> FrameOutcome:
        found = outcome(method, method.problem.source.copy())
        return change(found) if frame == 2 else found

    monkeypatch.setattr(Flow, "advance", advance)
    out = tmp_path / "a.vtkhdf"
    with pytest.raises(
        SimulationError, match=f"after 2 frames: the method 'flow' returned .*{cause}"
    ):
        list(morph("sphere", "star", CONFIG, out=out))
    with Trajectory(out) as stored:
        assert stored.frame_count == 2
