"""A run as a film: even speed through the joints of legs, loops that close, what is seen of it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from morph_engine.errors import ConfigError
from morph_engine.export import check, export, html
from morph_engine.presets import configure
from morph_engine.rendering.camera_path import CameraKey, CameraPath, View
from morph_engine.rendering.pictures import video
from morph_engine.results.playback import Playback, picture_table
from morph_engine.results.run_record import RunRecord, placement_of
from morph_engine.results.spool import Spool
from morph_engine.results.timeline import Timing
from morph_engine.results.trajectory import Trajectory, write_result

FILM = Path(__file__).resolve().parents[2] / "server/web/src/standalone/film.js"
NODE = Path(sys.executable).with_name("node")

H = 0.5
SIZE = (64, 48)
SHARES = (0.05, 0.5, 0.95, 1.0)
"""Of a leg, after each of its frames: matter is slow at both ends, as methods make it."""


@pytest.fixture(scope="module")
def loop(
    tmp_path_factory: pytest.TempPathFactory, lattice_ball: Callable[[float, float], np.ndarray]
) -> Path:
    """A ball that becomes an egg, a disc and a ball again, in which every particle is elsewhere."""
    ball = lattice_ball(3.1, H)
    chance = np.random.default_rng(0)
    turned = np.stack([ball[:, 1], -ball[:, 0], ball[:, 2]], axis=1)
    shaken = turned + chance.normal(0, 0.05, ball.shape)
    stops = [ball, ball * np.float32([1, 1.4, 1]), ball * np.float32([1.5, 0.5, 1]), shaken]
    config = configure("fast", {"sampling.points_per_cell_edge": 2, "frames": len(SHARES)})
    record = RunRecord(
        config=config,
        source=ball,
        target=ball,
        source_points=ball,
        target_points=ball,
        via=(stops[1], stops[2]),
        via_points=(stops[1], stops[2]),
        placement=placement_of(ball, ball, config, stops[1:3]),
    )
    path = tmp_path_factory.mktemp("loop") / "loop.vtkhdf"
    with Spool.create(path, record) as spool:
        for leg, (here, there) in enumerate(pairwise(stops)):
            for share in SHARES:
                positions = (here + share * (there - here)).astype(np.float32)
                spool.append(spool.frame_count, positions, {"s2t": share}, leg=leg)
        write_result(spool, status="complete")
        spool.remove()
    return path


def speeds(playback: Playback) -> list[np.ndarray]:
    """Mean way of the particles from picture to picture, by leg, without pictures at joints."""
    found: list[list[float]] = [[], [], []]
    for one, next_one in pairwise(playback.moments[:-1]):
        if one.leg == next_one.leg:
            way = playback.positions(next_one) - playback.positions(one)
            found[one.leg].append(float(np.linalg.norm(way, axis=1).mean()))
    return [np.array(leg) for leg in found]


def test_the_speed_is_the_same_on_both_sides_of_a_joint(loop: Path) -> None:
    """Within 10 %, and so all the way, where the computed frames are slow at each end of a leg."""
    with Trajectory(loop) as run:
        legs = speeds(Playback(run, Timing(3, 30, easing="linear", repeat="loop")))
    for before, after in pairwise([*legs, legs[0]]):
        assert after[0] == pytest.approx(before[-1], rel=0.1)
    assert np.ptp(np.concatenate(legs)) < 0.1 * np.concatenate(legs).mean()


def test_slow_ends_have_no_speed_at_a_joint(loop: Path) -> None:
    """A leg starts and ends at less than a tenth of its largest speed."""
    with Trajectory(loop) as run:
        for leg in speeds(Playback(run, Timing(9, 30, easing="in-out"))):
            assert max(leg[0], leg[-1]) < 0.1 * leg.max()


def test_a_loop_ends_as_it_begins(loop: Path) -> None:
    """The last picture is the first; in the one before, particles are in its places already."""
    with Trajectory(loop) as run:
        playback = Playback(run, Timing(3, 30, repeat="loop"))
        first, before, last = (playback.positions(playback.moments[index]) for index in (0, -2, -1))
        np.testing.assert_array_equal(first, last)
        ordered = np.sort(cKDTree(first).query(before)[1])
        np.testing.assert_array_equal(ordered, np.arange(len(first)))
        assert cKDTree(first).query(before)[0].max() < 0.1 * H
        values = playback.values(playback.moments[-2], first[:, 1])
        np.testing.assert_allclose(values, before[:, 1], atol=0.1)


def test_a_film_has_the_pictures_of_its_time(loop: Path, tmp_path: Path) -> None:
    """Two seconds at 6 pictures a second; of a loop the first and the last are the same file."""
    path = video(
        loop,
        tmp_path / "film.zip",
        size=SIZE,
        timing=Timing(2, 6, repeat="loop"),
        camera=CameraPath("orbit"),
        background="transparent",
    )
    with zipfile.ZipFile(path) as archive:
        files = [archive.read(name) for name in sorted(archive.namelist())]
    assert len(files) == 12
    assert files[0] == files[-1] != files[6]
    folder = video(loop, tmp_path / "film", size=SIZE, timing=Timing(0.5, 6), surface=True)
    assert sorted(file.name for file in folder.iterdir()) == [
        "frame-0000.png", "frame-0001.png", "frame-0002.png",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "codec", "decoder"),
    [("a.webm", "vp9", "libvpx-vp9"), ("a.mov", "prores", "prores")],
)
def test_videos_may_be_transparent(
    loop: Path, tmp_path: Path, name: str, codec: str, decoder: str
) -> None:
    """Nothing in the corners, matter in the middle; of the size and rate asked for."""
    video(
        loop,
        tmp_path / name,
        size=SIZE,
        timing=Timing(1, 5),
        background="transparent",
        field="speed",
    )
    with av.open(str(tmp_path / name)) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.average_rate) == (codec, 5)
        context = av.codec.CodecContext.create(decoder, "r")
        pictures = [
            picture.to_ndarray(format="rgba")
            for packet in file.demux(stream)
            for picture in context.decode(packet)
        ]
    assert len(pictures) == 5
    for picture in pictures:
        assert picture.shape == (SIZE[1], SIZE[0], 4)
        assert picture[0, 0, 3] < 8 and picture[24, 32, 3] > 247


def test_the_eye_goes_through_its_keys() -> None:
    """Smoothly, never beyond them, and rests before the first and after the last."""
    path = CameraPath(
        keys=(
            CameraKey(0.75, View(90, 40, 4.0)),
            CameraKey(0.25, View(0, 0)),
            CameraKey(0.5, View(90, 10, 2.0)),
        )
    )
    views = [path.at(share) for share in np.linspace(0, 1, 41)]
    assert (views[0], views[10]) == (View(0, 0), View(0, 0))
    assert views[20].azimuth == pytest.approx(90) and views[20].zoom == pytest.approx(2)
    assert views[40] == views[30] and views[30].elevation == pytest.approx(40)
    assert max(view.azimuth for view in views) <= 90 + 1e-9
    turn, orbit = CameraPath("turn"), CameraPath("orbit")
    assert turn.at(0).azimuth - turn.at(1).azimuth == pytest.approx(360)
    assert orbit.at(0.25).elevation > orbit.at(0).elevation > orbit.at(0.75).elevation


def test_a_gif_lasts_as_long_as_asked(loop: Path, tmp_path: Path) -> None:
    """One second, although 30 pictures a second are no whole hundredths each."""
    path = video(loop, tmp_path / "a.gif", size=SIZE, timing=Timing(1, 30, easing="linear"))
    with Image.open(path) as image:
        durations = []
        for index in range(image.n_frames):
            image.seek(index)
            durations.append(image.info["duration"])
    assert sum(durations) == 1000


def test_a_player_gets_a_frame_for_each_picture(loop: Path) -> None:
    """From the first frame to the last one and back, at the end of a leg where it is passed."""
    with Trajectory(loop) as run:
        table = picture_table(run, Timing(3, 30, easing="overshoot", repeat="ping-pong"))
    assert (table["fps"], table["repeat"], len(table["frames"])) == (30, True, 90)
    assert (table["frames"][0], max(table["frames"]), table["frames"][-1]) == (0, 11, 0)


SHOWN = """
import { unpack } from "@FILM";
let text = "";
for await (const part of process.stdin) text += part;
const { about, packed } = JSON.parse(text);
const film = await unpack(about, packed);
const { frames, closing } = about.timing;
const shown = frames.map((moment, i) => ({
  points: [...film.positions(moment, closing?.[i])],
  vertices: [...film.surface(moment, closing?.[i]).vertices],
}));
console.log(JSON.stringify(shown));
"""
"""What the viewer of a file shows in each picture, in JavaScript."""


def test_a_loop_closes_in_the_viewer_as_in_videos(
    loop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing jumps from picture to picture, and the last one shows what the first one does."""
    for name in ("viewer.js", "viewer.css", "licenses.txt"):
        (tmp_path / name).touch()
    monkeypatch.setattr(html, "VIEWER", tmp_path)
    timing = Timing(3, 30, easing="linear", repeat="loop")
    path = export(loop, tmp_path / "loop.html", "html", tracked=True, timing=timing)
    text = path.read_text(encoding="utf-8")
    about, packed = (re.findall(f'id="{name}">([^<]*)<', text)[0] for name in ("about", "frames"))
    given = json.dumps({"about": json.loads(about), "packed": packed})
    command = [NODE, "--input-type=module", "-e", SHOWN.replace("@FILM", FILM.as_uri())]
    printed = subprocess.run(command, input=given, capture_output=True, text=True, check=True)
    pictures = json.loads(printed.stdout)
    points = [np.reshape(shown["points"], (-1, 3)) for shown in pictures]
    steps = [np.abs(after - before).max() for before, after in pairwise(points)]
    assert len(points) == 90 and max(steps) < 0.6 * H
    step = json.loads(about)["scale"] / html.LEVELS
    apart, places = cKDTree(points[0]).query(points[-1])
    assert apart.max() < 2 * step and len(set(places)) == len(points[0])
    first, last = (np.reshape(pictures[index]["vertices"], (-1, 3)) for index in (0, -1))
    for one, other in ((first, last), (last, first)):
        assert cKDTree(one).query(other)[0].mean() < 0.3 * H


def test_backgrounds_have_the_colour_asked_for(loop: Path, tmp_path: Path) -> None:
    """By name or number, at the corner of a picture."""
    for color, wanted in (("#203040", (32, 48, 64)), ("black", (0, 0, 0))):
        folder = video(loop, tmp_path / color[1:], size=SIZE, frames=[0], background=color, fps=1)
        with Image.open(folder / "frame-0000.png") as picture:
            assert picture.getpixel((0, 0)) == wanted


def test_a_moving_mesh_keeps_the_time(loop: Path, tmp_path: Path) -> None:
    """A key per picture up to the end; there and back, shares end as they begin. No loop."""
    path = tmp_path / "egg.glb"
    export(loop, path, "glb", tracked=True, timing=Timing(2, 10, repeat="ping-pong"))
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    (animation,) = document["animations"]
    times, values = (
        document["accessors"][animation["samplers"][0][name]] for name in ("input", "output")
    )
    assert (times["count"], times["max"]) == (20, [2])
    view = document["bufferViews"][values["bufferView"]]
    begin = 20 + length + 8 + view["byteOffset"]
    shares = np.frombuffer(data[begin : begin + 4 * values["count"]], "<f4").reshape(20, -1)
    np.testing.assert_allclose(shares[0], shares[-1], atol=1e-6)
    assert shares[10].sum() == pytest.approx(1, abs=1e-5)
    with pytest.raises(ConfigError, match="ping-pong"):
        export(loop, tmp_path / "b.glb", "glb", tracked=True, timing=Timing(2, repeat="loop"))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda run, to: video(run, to / "a.mp4", background="transparent"),
            "cannot have a transparent",
        ),
        (lambda run, to: video(run, to / "a.mp4", background="mauvish"), "no colour"),
        (lambda run, to: video(run, to / "a.gif", frames=[0], timing=Timing(1)), "whole run"),
        (lambda run, to: check("ply", timing=Timing(1)), "does not support a playing time"),
        (lambda run, to: check("glb", surface=True, timing=Timing(1)), "tracked surface"),
        (lambda run, to: check("gif", frames=[1], timing=Timing(1)), "whole run"),
        (lambda run, to: check("pc2", surface=True), "tracked surfaces only"),
        (lambda run, to: CameraKey(1.5, View()), "from 0 to 1"),
        (lambda run, to: CameraKey(1, View(elevation=95)), "-90 to 90"),
        (lambda run, to: CameraKey(np.nan, View()), "from 0 to 1"),
        (lambda run, to: CameraKey(0, View(azimuth=np.nan)), "azimuth nan"),
        (lambda run, to: CameraKey(0, View(azimuth=-np.inf)), "azimuth -inf"),
        (lambda run, to: CameraKey(0, View(elevation=np.nan)), "-90 to 90"),
        (lambda run, to: CameraKey(0, View(zoom=np.nan)), "from 0.1 to 100"),
        (lambda run, to: CameraPath(keys=2 * (CameraKey(0, View()),)), "same time"),
    ],
)
def test_what_cannot_be_is_refused(
    loop: Path, tmp_path: Path, call: Callable[[Path, Path], object], words: str
) -> None:
    """With cause and remedy, and nothing written."""
    with pytest.raises(ConfigError, match=words):
        call(loop, tmp_path)
    assert not list(tmp_path.iterdir())
