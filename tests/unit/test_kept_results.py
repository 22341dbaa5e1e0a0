"""What is kept equals what is computed, and costs nothing where it cannot be kept."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from morph_engine import kept_results
from morph_engine.kept_results import keep_in, kept
from morph_engine.morphing import morph
from morph_engine.presets import configure

POINTS = np.arange(12.0).reshape(4, 3)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder that results are kept in."""
    keep_in(tmp_path / "kept")
    yield tmp_path / "kept"
    keep_in(None)


class Doubling:
    """Doubles an array, and counts how often."""

    count = 0

    def __call__(self) -> kept_results.Arrays:
        """Double it."""
        self.count += 1
        return {"doubled": 2 * POINTS, "name": np.asarray("two")}


def test_the_same_inputs_are_computed_once(folder: Path) -> None:
    """Other values, types, shapes or names are other inputs."""
    double = Doubling()
    first, second = (kept("double", (POINTS, 1.5, "a"), double) for _ in range(2))
    assert double.count == 1
    np.testing.assert_array_equal(first["doubled"], second["doubled"])
    assert first.keys() == second.keys()
    others = [
        (POINTS + 1e-15, 1.5, "a"), (POINTS.astype(np.float32), 1.5, "a"),
        (POINTS.reshape(3, 4), 1.5, "a"), (POINTS, 1.5000001, "a"), (POINTS, 1.5, "b"),
    ]  # fmt: skip
    for inputs in others:
        kept("double", inputs, double)
    kept("other", (POINTS, 1.5, "a"), double)
    assert double.count == 2 + len(others)
    assert len([*folder.iterdir()]) == 2 + len(others)


def test_nothing_is_kept_unless_asked_for(tmp_path: Path) -> None:
    """The library writes nowhere by itself."""
    double = Doubling()
    for _ in range(2):
        kept("double", (POINTS,), double)
    assert double.count == 2


@pytest.mark.parametrize("damage", [b"", b"PK nonsense", None])
def test_a_damaged_file_is_replaced(folder: Path, damage: bytes | None) -> None:
    """Empty, of something else, or cut off."""
    double = Doubling()
    kept("double", (POINTS,), double)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:-40] if damage is None else damage)
    for _ in range(2):
        np.testing.assert_array_equal(kept("double", (POINTS,), double)["doubled"], 2 * POINTS)
    assert double.count == 2


def test_a_flipped_bit_costs_only_time(folder: Path) -> None:
    """One in a header calls a file encrypted, or packed in a way that nobody knows."""
    kept("double", (POINTS,), Doubling())
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    for bit in range(0, 8 * len(whole), 5):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        file.write_bytes(damaged)
        np.testing.assert_array_equal(kept("double", (POINTS,), Doubling())["doubled"], 2 * POINTS)


def test_a_folder_that_cannot_be_made_costs_nothing(tmp_path: Path) -> None:
    """Such as below a file."""
    (tmp_path / "file").touch()
    keep_in(tmp_path / "file" / "kept")
    try:
        np.testing.assert_array_equal(kept("double", (POINTS,), Doubling())["doubled"], 2 * POINTS)
    finally:
        keep_in(None)


def test_a_user_without_a_home_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container whose user has no entry; unless XDG_CACHE_HOME says where."""

    def homeless(uid: int) -> None:
        raise KeyError(uid)

    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("pwd.getpwuid", homeless)
    assert kept_results.user_folder() is None
    monkeypatch.setenv("XDG_CACHE_HOME", "/cache")
    assert kept_results.user_folder() == Path("/cache/chamfer-morph")


def test_the_oldest_go_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those used longest ago, beyond the size that all may have."""
    double = Doubling()
    for number in range(3):
        kept("double", (number,), double)
    size = next(folder.iterdir()).stat().st_size
    monkeypatch.setattr(kept_results, "MOST_BYTES", 3 * size)
    kept("double", (0,), double)  # used again
    kept("double", (3,), double)
    assert double.count == 4
    kept("double", (0,), double)
    assert double.count == 4
    kept("double", (1,), double)
    assert double.count == 5


def test_a_run_is_the_same_to_the_last_bit(folder: Path) -> None:
    """With what is computed, and with what was kept."""
    config = configure(overrides={"sampling.points_per_cell_edge": 1, "frames": 2})

    def positions() -> np.ndarray:
        return np.stack([frame.positions for frame in morph("sphere", "star", config, threads=1)])

    keep_in(None)
    alone = positions()
    keep_in(folder)
    for _ in range(2):
        np.testing.assert_array_equal(positions(), alone)
    assert {file.name.partition("-")[0] for file in folder.iterdir()} == {
        "shape", "filling", "distance", "controls", "registration",
    }  # fmt: skip
