"""Results of version 0.1.0: read, repeated and resumed, to the bit."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from morph_engine import Trajectory
from morph_engine.config import MorphConfig
from morph_engine.errors import ConfigError
from morph_engine.morphing import run
from morph_engine.presets import configure
from morph_engine.results.spool import Spool

METHODS: dict[str, dict[str, Any]] = {
    "transport": {"destinations": "random", "sweeps": 3, "kernel": "quadratic"},
    "joint": {
        "chamfer.start_frame": 0,
        "chamfer.ramp_frames": 1,
        "chamfer.normalize": False,
        "optimizer.passes": 1,
        "smoothing.late_frame": 1,
    },
    "dco": {
        "descent.steps_per_frame": 3,
        "regularizers.repulsion": 0.02,
        "descent.beta1": 0.8,
        "grid.margin": 0.5,
    },
}
"""Settings of the stored runs by method, under their names of today."""


STORED_PRESETS = {"fast": "fast-3", "published": "published-1"}
"""The versions that the presets had."""


def expected(method: str) -> MorphConfig:
    """The configuration of a stored run."""
    shared = {
        "frames": 3,
        "sampling.points_per_cell_edge": 2,
        "sampling.fit": "none",  # then the only default
        "grid.half_extent": 6.0,
    }
    preset = "published" if method == "joint" else "fast"
    config = configure(preset, {"method": method, **shared, **METHODS[method]})
    return config.model_copy(update={"preset": STORED_PRESETS[preset]})


@pytest.mark.parametrize("method", METHODS)
def test_a_result_is_read(version_0_1_0: Path, method: str) -> None:
    """Its configuration is today's, every setting at its place, and no setting is left over."""
    with Trajectory(version_0_1_0 / f"{method}.vtkhdf") as result:
        assert result.config == expected(method)
        assert len(result) == 3 and np.isfinite(result.positions(-1)).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_result_is_repeated_to_the_bit(version_0_1_0: Path, method: str) -> None:
    """`run` from the record alone makes the same positions in every frame."""
    with Trajectory(version_0_1_0 / f"{method}.vtkhdf") as result:
        for frame, stored in zip(run(result.run, device="cpu", threads=1), result, strict=True):
            np.testing.assert_array_equal(frame.positions, stored)


@pytest.mark.parametrize("method", METHODS)
def test_an_unfinished_run_is_resumed_to_the_bit(version_0_1_0: Path, method: str) -> None:
    """From its run directory it goes on to the frames of the run that was not interrupted."""
    out = version_0_1_0 / f"{method}-unfinished.vtkhdf"
    with Spool.open(out, writable=False) as spool:
        record = spool.run
        assert record.config == expected(method) and spool.frame_count == 2
    list(run(record, device="cpu", threads=1, out=out, resume=True))
    with Trajectory(out) as resumed, Trajectory(version_0_1_0 / f"{method}.vtkhdf") as unbroken:
        assert resumed.status == "complete" and resumed.config == expected(method)
        np.testing.assert_array_equal(np.stack(list(resumed)), np.stack(list(unbroken)))


def test_the_command_line_repeats_a_result(version_0_1_0: Path) -> None:
    """`morph rerun` finds no difference."""
    command = [sys.executable, "-m", "chamfer_morph", "rerun", "dco.vtkhdf", "--threads", "1"]
    process = subprocess.run(
        [*command, "--device", "cpu", "--json"],
        cwd=version_0_1_0, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert json.loads(process.stdout)["difference"] == 0


def test_old_names_of_settings_are_understood() -> None:
    """Where the method has the setting, and only there."""
    old = {
        "method": "transport",
        "transport.places": "random",
        "watchdog.domain_margin": 1,
        "grid.kernel": "quadratic",
    }
    new = {"method": "transport", "destinations": "random", "grid.margin": 1, "kernel": "quadratic"}
    assert configure("fast", old) == configure("fast", new)
    with pytest.raises(ConfigError, match="belongs to dcd"):
        configure("fast", {"density.weighting": "inverse"})
