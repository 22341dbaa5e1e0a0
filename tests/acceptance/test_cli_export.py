"""`morph export` and `morph render` as a user meets them."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import av
import numpy as np
import pytest
import trimesh
from PIL import Image

from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import write_result
from tests.patience import PATIENCE

MORPH = Path(sys.executable).with_name("morph")
GENERATOR = np.random.default_rng(3)
SOURCE = GENERATOR.uniform(-2, 2, (600, 3)).astype(np.float32)


def rising_box(path, frames):
    """The result of a box of particles that rises."""
    config = configure("fast", {"sampling.points_per_cell_edge": 2, "frames": frames})
    record = RunRecord(config, SOURCE, SOURCE, SOURCE, SOURCE)
    with Spool.create(path, record) as spool:
        for frame in range(frames):
            spool.append(frame, SOURCE + np.float32([0, frame, 0]), {"s2t": float(frame)})
        write_result(spool, status="complete")
        spool.remove()
    return path


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A box of particles that rises in two frames."""
    return rising_box(tmp_path_factory.mktemp("result") / "box.vtkhdf", frames=2)


def morph(*arguments, cwd):
    """Run the command and capture what it prints."""
    return subprocess.run(
        [MORPH, *map(str, arguments)], cwd=cwd, timeout=600, capture_output=True, text=True
    )


def test_the_ending_names_the_format(result, tmp_path):
    """One frame in a .ply, all metrics in a .csv, a zip where it is said what of."""
    assert morph("export", result, "-o", "last.ply", cwd=tmp_path).returncode == 0
    cloud = trimesh.load(tmp_path / "last.ply")
    np.testing.assert_allclose(cloud.vertices, SOURCE + np.float32([0, 1, 0]), atol=1e-6)
    assert morph("export", result, "-o", "metrics.csv", cwd=tmp_path).returncode == 0
    with (tmp_path / "metrics.csv").open() as file:
        assert [row["s2t"] for row in csv.DictReader(file)] == ["0.0", "1.0"]
    outcome = morph("export", result, "-o", "all.zip", "--format", "obj", "--json", cwd=tmp_path)
    assert json.loads(outcome.stdout)["out"] == "all.zip"
    with zipfile.ZipFile(tmp_path / "all.zip") as archive:
        assert len(archive.namelist()) == 2


def test_a_moving_mesh_is_one_file(result, tmp_path):
    """A GLB with an animation at the pace asked for; the JSON has what one should know of it."""
    options = ("--tracked", "--fps", "10", "--json")
    outcome = morph("export", result, "-o", "box.glb", *options, cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads(outcome.stdout)["notes"] == []
    data = (tmp_path / "box.glb").read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    (animation,) = document["animations"]
    times = document["accessors"][animation["samplers"][0]["input"]]
    assert (times["count"], times["max"]) == (2, [pytest.approx(0.1)])


def test_render_makes_a_video(result, tmp_path):
    """An MP4 of the size asked for."""
    outcome = morph(
        "render", result, "-o", "box.mp4", "--size", "64x48", "--color", "speed", cwd=tmp_path
    )
    assert outcome.returncode == 0, outcome.stderr
    with av.open(str(tmp_path / "box.mp4")) as video:
        assert (video.streams.video[0].width, video.streams.video[0].height) == (64, 48)


def test_a_still_of_3840_by_2160(result, tmp_path):
    """One frame in a look, on ground that its shadow falls on: matter in the middle alone."""
    options = ("--frames", "-1", "--size", "3840x2160", "--look", "porcelain")
    outcome = morph("render", result, "-o", "still.png", *options, cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    with Image.open(tmp_path / "still.png") as still:
        assert still.size == (3840, 2160)
        assert still.convert("RGB").getpixel((5, 5)) == (255, 255, 255)
        assert still.convert("RGB").getpixel((1920, 1080)) != (255, 255, 255)


def test_render_keeps_a_time_of_its_own(result, tmp_path):
    """A second at 5 pictures a second, from all around, on nothing; JSON tells what was written."""
    options = ("--seconds", 1, "--fps", 5, "--easing", "linear", "--repeat", "ping-pong")
    look = ("--camera", "orbit", "--background", "transparent", "--size", "64x48", "--json")
    outcome = morph("render", result, "-o", "box.webm", *options, *look, cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    with av.open(str(tmp_path / "box.webm")) as video:
        assert len(list(video.decode(video=0))) == 5
    keys = ("--camera-key", "0:25,15", "--camera-key", "1:90,40,2")
    outcome = morph("render", result, "-o", "pictures", "--size", "64x48", *keys, cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert len(list((tmp_path / "pictures").iterdir())) == 2 + 12  # two frames, and a second


def test_no_force_replaces_the_result_that_is_read(result, tmp_path):
    """It is refused with a remedy, and the result stays."""
    own = tmp_path / "own.vtkhdf"
    own.write_bytes(result.read_bytes())
    for command in (("export", "--format", "npz"), ("export", "--format", "ply"), ("render",)):
        outcome = morph(command[0], own, "-o", own, *command[1:], "--force", cwd=tmp_path)
        assert outcome.returncode == 2
        assert "would replace" in outcome.stderr and "another file" in outcome.stderr
    assert own.read_bytes() == result.read_bytes()


@pytest.mark.parametrize("command", [("export", "--format", "ply"), ("render", "--size", "64x48")])
def test_a_folder_is_replaced_only_by_force(result, tmp_path, command):
    """One that holds anything is refused as a file is; an empty one is not."""
    name, *options = command
    folder = tmp_path / "all"
    folder.mkdir()
    assert morph(name, result, "-o", folder, *options, cwd=tmp_path).returncode == 0
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    again = (name, result, "-o", folder, "--frames", "0", *options)
    outcome = morph(*again, cwd=tmp_path)
    assert outcome.returncode == 2
    assert "already exists" in outcome.stderr and "--force" in outcome.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert morph(*again, "--force", cwd=tmp_path).returncode == 0
    assert len(list(folder.iterdir())) < len(before)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("export", "RESULT", "-o", "x.zip"), "--format"),
        (("export", "RESULT", "-o", "x.stl"), "surface"),
        (("export", "RESULT", "-o", "x.ply", "--format", "stl", "--surface"), ".stl"),
        (("export", "RESULT", "-o", "x.ply", "--snap"), "--surface"),
        (("export", "RESULT", "-o", "x.ply", "--tracked"), "glb, usd"),
        (("export", "RESULT", "-o", "x.ply", "--frames", "5-2"), "0,5,10-20"),
        (("export", "RESULT", "-o", "x.ply", "--fields", "det_f"), "joint and physics"),
        (("export", "gone.vtkhdf", "-o", "x.ply"), "Check the path"),
        (("render", "RESULT", "-o", "x.mp4", "--size", "big"), "960x720"),
        (("render", "RESULT", "-o", "x.gif", "--snap"), "--surface"),
        (("render", "RESULT", "-o", "x.gif", "--seconds", "1", "--hold", "1"), "pauses"),
        (("render", "RESULT", "-o", "x.gif", "--camera-key", "0:1"), "0.5:90,30,1.5"),
        (("render", "RESULT", "-o", "x.gif", "--background", "transparent"), "webm"),
        (("render", "RESULT", "-o", "x.gif", "--background", "blakc"), "Did you mean 'black'?"),
        (("export", "RESULT", "-o", "x.ply", "--seconds", "1"), "mp4"),
    ],
)
def test_refusals_have_cause_and_remedy(result, tmp_path, arguments, word):
    """Exit status 2, two lines, no traceback, and no file."""
    named = [result if argument == "RESULT" else argument for argument in arguments]
    outcome = morph(*named, cwd=tmp_path)
    assert outcome.returncode == 2, outcome.stderr
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 2 and word in outcome.stderr, outcome.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="signals as of POSIX")
def test_an_interrupted_export_leaves_nothing(tmp_path_factory, tmp_path):
    """Ctrl-C ends the command with its own status, and takes along what was begun."""
    result = rising_box(tmp_path_factory.mktemp("long") / "box.vtkhdf", frames=200)
    arguments = ["export", result, "-o", "all.zip", "--format", "obj", "--surface"]
    process = subprocess.Popen([MORPH, *map(str, arguments)], cwd=tmp_path, stderr=subprocess.PIPE)
    deadline = time.monotonic() + PATIENCE
    while not (tmp_path / "all.zip.tmp.obj").exists():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    assert b"Stopped by Ctrl-C" in process.communicate(timeout=120)[1]
    assert process.returncode == 130
    assert list(tmp_path.iterdir()) == []
