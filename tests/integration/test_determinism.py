"""The same numbers whatever the number of threads: each run is a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from morph_engine import Trajectory


@pytest.mark.parametrize(
    ("method", "settings"), [("physics", ()), ("joint", ("--set", "chamfer.start_frame=0"))]
)
def test_positions_do_not_depend_on_threads(
    method: str, settings: tuple[str, ...], tmp_path: Path
) -> None:
    """One and two threads give bitwise equal positions in frame 5, with Chamfer from frame 0 on."""
    positions = []
    for threads in (1, 2):
        out = tmp_path / f"{threads}.vtkhdf"
        subprocess.run(
            [sys.executable, "-m", "chamfer_morph", "run", "sphere", "torus", "--method", method,
             "--frames", "6", "--points-per-cell-edge", "2", "--threads", str(threads),
             *settings, "--device", "cpu", "--out", str(out), "--json"],
            check=True, capture_output=True, timeout=300,
        )  # fmt: skip
        with Trajectory(out) as trajectory:
            positions.append(trajectory.positions(5))
    np.testing.assert_array_equal(*positions)
