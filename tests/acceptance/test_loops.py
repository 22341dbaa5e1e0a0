"""A morph through several shapes and back, as a film that may be played for ever."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from morph_engine.results.playback import Playback
from morph_engine.results.timeline import Timing
from morph_engine.results.trajectory import Trajectory
from tests.unit.test_playback import speeds

MORPH = Path(sys.executable).with_name("morph")
TIME = ("--seconds", "3", "--fps", "30", "--repeat", "loop", "--easing", "linear")


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run from a sphere to a star, a torus and the sphere again."""
    path = tmp_path_factory.mktemp("loop") / "loop.vtkhdf"
    few = ("--frames", "10", "--points-per-cell-edge", "1", "--quiet")
    shapes = ("sphere", "star", "torus", "sphere")
    subprocess.run([MORPH, "run", *shapes, "--out", path, *few], check=True)
    return path


def render(result: Path, name: str) -> Path:
    """A film of it in three seconds."""
    film = result.with_name(name)
    options = ("--size", "160x120", *TIME)
    subprocess.run([MORPH, "render", result, "-o", film, *options], check=True)
    return film


def steps(pictures: list[np.ndarray]) -> np.ndarray:
    """How much each picture differs from the one before, in levels of 255."""
    floats = [picture.astype(float) for picture in pictures]
    return np.array([np.abs(b - a).mean() for a, b in pairwise(floats)])


def test_a_film_through_three_shapes_ends_as_it_begins_and_never_jumps(loop: Path) -> None:
    """90 pictures: the last is the first, and each step is about as large as the one before.

    A quarter is for what a picture shows of an even speed: silhouettes differ from shape to shape.
    """
    with zipfile.ZipFile(render(loop, "film.zip")) as archive:
        names = sorted(archive.namelist())
        pictures = [
            np.asarray(Image.open(io.BytesIO(archive.read(name))).convert("RGB")) for name in names
        ]
    assert len(pictures) == 90
    np.testing.assert_array_equal(pictures[0], pictures[-1])
    moved = steps(pictures)
    assert moved.min() > 0.5
    again = np.append(moved, moved[0])  # where it begins anew
    assert np.abs(np.diff(np.log(again))).max() < np.log(1.25)


def test_matter_moves_evenly_through_a_real_film(loop: Path) -> None:
    """From picture to picture its mean speed changes by less than 10 %, also from leg to leg."""
    with Trajectory(loop) as run:
        legs = speeds(Playback(run, Timing(3, 30, easing="linear", repeat="loop")))
    for before, after in pairwise([*legs, legs[0]]):
        assert after[0] == pytest.approx(before[-1], rel=0.1)
    for leg in legs:
        np.testing.assert_allclose(leg[1:], leg[:-1], rtol=0.1)


def test_the_video_lasts_as_long_as_asked(loop: Path) -> None:
    """30 pictures a second for three seconds, the last like the first but for compression."""
    with av.open(str(render(loop, "film.mp4"))) as film:
        stream = film.streams.video[0]
        assert stream.average_rate == 30
        assert stream.duration is not None and stream.time_base is not None
        assert float(stream.duration * stream.time_base) == pytest.approx(3, abs=0.02)
        pictures = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(pictures) == 90
    ends = np.abs(pictures[0].astype(float) - pictures[-1]).mean()
    assert ends < steps(pictures).min()
