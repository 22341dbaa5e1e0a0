"""The same numbers whatever the number of threads: each run is a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from morph_engine import Trajectory
from tests.patience import PATIENCE


def test_positions_do_not_depend_on_threads(tmp_path: Path) -> None:
    """One and two threads give bitwise equal positions in frame 5, with Chamfer from frame 0 on.

    So do they without it, as `joint` computes all that `physics` does.
    """
    positions = []
    for threads in (1, 2):
        out = tmp_path / f"{threads}.vtkhdf"
        subprocess.run(
            [sys.executable, "-m", "chamfer_morph", "run", "sphere", "torus", "--method", "joint",
             "--frames", "6", "--points-per-cell-edge", "2", "--threads", str(threads),
             "--set", "chamfer.start_frame=0", "--device", "cpu", "--out", str(out), "--json"],
            check=True, capture_output=True, timeout=PATIENCE,
        )  # fmt: skip
        with Trajectory(out) as trajectory:
            positions.append(trajectory.positions(5))
    np.testing.assert_array_equal(*positions)
