"""Several morphs in one process, one after another, at once, and in forked processes."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from morph_engine import configure, morph
from morph_engine.errors import ConfigError, DeviceError

CONFIG = configure(overrides={"sampling.points_per_cell_edge": 1, "frames": 3})
DOUBLE = configure(
    "fast", {"sampling.points_per_cell_edge": 1, "frames": 3, "precision": "float64"}
)

AFTER_A_FORK = """
import multiprocessing
from morph_engine import configure, morph
from morph_engine.errors import DeviceError

CONFIG = configure(overrides={"sampling.points_per_cell_edge": 1, "frames": 1})

def told(_):
    try:
        return len(list(morph("sphere", "star", CONFIG)))
    except DeviceError as error:
        return str(error)

list(morph("sphere", "star", CONFIG))
with multiprocessing.get_context("fork").Pool(1) as pool:
    print(pool.map(told, [0])[0])
"""


def test_one_with_other_settings_waits_for_those_in_progress() -> None:
    """It is refused, as it would take their arrays away, and they go on as if nothing was."""
    alone = list(morph("sphere", "star", CONFIG, threads=2))
    first = morph("sphere", "star", CONFIG, threads=2)
    frames = [next(first)]
    for config, threads in ((CONFIG, 1), (DOUBLE, 2)):
        with pytest.raises(DeviceError, match="in progress, with cpu, 2 threads") as refused:
            next(morph("sphere", "torus", config, threads=threads))
        assert "close" in refused.value.remedy
    assert len(list(morph("sphere", "torus", CONFIG, threads=2))) == 3
    frames += first
    for frame, same in zip(frames, alone, strict=True):
        np.testing.assert_array_equal(frame.positions, same.positions)
    assert len(list(morph("sphere", "torus", CONFIG, threads=1))) == 3


def test_one_that_was_closed_is_no_longer_in_progress() -> None:
    """By hand, or as nobody has it any more."""
    first = morph("sphere", "star", CONFIG, threads=2)
    next(first)
    first.close()
    next(morph("sphere", "star", CONFIG, threads=1))
    next(morph("sphere", "star", CONFIG, threads=2))


@pytest.mark.parametrize("threads", [-1, 1.5, "2", 10**6])
def test_a_number_of_threads_that_cannot_be_is_refused(threads: object) -> None:
    """Before any is started."""
    with pytest.raises(ConfigError, match=r"There cannot be .* CPU threads"):
        next(morph("sphere", "star", CONFIG, threads=threads))  # type: ignore[arg-type]


def test_a_forked_process_says_that_it_cannot_compute() -> None:
    """Taichi's threads are not in it, and a kernel would wait for them for ever."""
    ran = subprocess.run(
        [sys.executable, "-c", AFTER_A_FORK], capture_output=True, text=True, timeout=240
    )
    assert "forked" in ran.stdout, ran.stderr
    assert "spawn" in ran.stdout
