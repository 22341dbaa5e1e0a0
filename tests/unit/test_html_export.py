"""The viewer's file: what is packed comes out again, and names are text."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from morph_engine.errors import MeshError, ResultError
from morph_engine.export import export, html
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.placement import Placement
from morph_engine.geometry.sampling import Similarity
from morph_engine.geometry.surface_reconstruction import reconstruct_surface
from morph_engine.morphing import prepare
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord
from morph_engine.results.selection import Selection
from morph_engine.results.spool import Spool
from morph_engine.results.timeline import Timing
from morph_engine.results.tracked_surface import CELL_OVER_H, TrackedMesh, TrackedSurface
from morph_engine.results.trajectory import Trajectory, write_result


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a viewer as large as the real one, which tests of the text do without."""
    folder = tmp_path / "viewer"
    folder.mkdir()
    for name, size in (("viewer.js", 700_000), ("viewer.css", 15_000), ("licenses.txt", 5_000)):
        (folder / name).write_text(" " * size)
    monkeypatch.setattr(html, "VIEWER", folder)
    return folder


def stored(path: Path, record: RunRecord, frames: Iterator[np.ndarray]) -> Path:
    """A result with these positions."""
    with Spool.create(path, record) as spool:
        for index, positions in enumerate(frames):
            spool.append(index, positions.astype(np.float32), {"s2t": 1.0})
        write_result(spool, status="complete")
    return path


def arrays(page: str) -> bytes:
    """What the viewer unpacks."""
    (packed,) = re.findall(r'id="frames">([^<]*)<', page)
    return zlib.decompress(base64.b64decode(packed))


def unpacked(chunk: bytes, frames: int, count: int) -> np.ndarray:
    """16-bit shares by frame from differences, shape [T, n, 3]."""
    moved = np.frombuffer(chunk, "<u2").reshape(frames, count, 3)
    return np.cumsum(moved, axis=0, dtype=np.uint16)


def test_positions_come_out_as_they_went_in() -> None:
    """Within half a step of the scale, for particles and for a surface that changes once."""
    chance = np.random.default_rng(1)
    points = chance.uniform(-8, 12, (5, 40, 3))
    meshes = tuple(
        TrackedMesh(
            frames=frames,
            vertices=chance.uniform(-8, 12, (len(frames), 9, 3)),
            normals=np.zeros((len(frames), 9, 3)),
            faces=chance.integers(0, 9, (4, 3)).astype(np.int32),
        )
        for frames in ((2, 4, 6), (6, 8, 10))
    )
    about, packed = html.pack((2, 4, 6, 8, 10), points, TrackedSurface(meshes, 6))
    assert [surface["frames"] for surface in about["surfaces"]] == [[0, 1, 2], [2, 3, 4]]
    data, at = zlib.decompress(packed), 0
    step = about["scale"] / html.LEVELS
    for positions, faces in [(points, None), *((mesh.vertices, mesh.faces) for mesh in meshes)]:
        frames, count, _ = positions.shape
        size = 2 * positions.size
        levels = unpacked(data[at : at + size], frames, count)
        found = np.array(about["offset"]) + step * levels
        np.testing.assert_allclose(found, positions, atol=step / 2 * (1 + 1e-9))
        at += size
        if faces is not None:
            size = 4 * faces.size
            stored = np.frombuffer(data[at : at + size], "<u4").reshape(-1, 3)
            np.testing.assert_array_equal(stored, faces)
            at += size
    assert at == len(data)


def test_lost_particles_are_left_out(built: Path, tmp_path: Path) -> None:
    """They are nowhere; all others are where they were."""
    points = np.random.default_rng(2).uniform(-5, 5, (50, 3)).astype(np.float32)
    lost = points.copy()
    lost[7] = np.nan
    record = RunRecord(configure("fast", {"frames": 2}), points, points, points, points)
    with Trajectory(stored(tmp_path / "r.vtkhdf", record, iter([points, lost]))) as run:
        page = html.page(Selection(run, (0, 1)))
    about = json.loads(re.findall(r'id="about">([^<]*)<', page)[0])
    assert about["points"]["count"] == 49
    step = about["scale"] / html.LEVELS
    found = np.array(about["offset"]) + step * unpacked(arrays(page), 2, 49)
    np.testing.assert_allclose(found[1], np.delete(points, 7, axis=0), atol=0.51 * step)


def test_a_particle_far_away_is_left_out(built: Path, tmp_path: Path) -> None:
    """In 16 bits all others would have one place."""
    points = np.random.default_rng(2).uniform(-5, 5, (50, 3)).astype(np.float32)
    stray = points.copy()
    stray[7] = 1e6
    record = RunRecord(configure("fast", {"frames": 2}), points, points, points, points)
    with Trajectory(stored(tmp_path / "r.vtkhdf", record, iter([points, stray]))) as run:
        page = html.page(Selection(run, (0, 1)))
    about = json.loads(re.findall(r'id="about">([^<]*)<', page)[0])
    assert about["points"]["count"] == 49
    assert about["scale"] < 10
    assert "(49 shown)" in page


def test_where_no_particle_is_left_there_is_no_viewer(built: Path, tmp_path: Path) -> None:
    """An export says which frame is empty, a notebook shows the object without a viewer."""
    points = np.random.default_rng(2).uniform(-5, 5, (50, 3)).astype(np.float32)
    halves = [points.copy(), points.copy()]
    halves[0][:25] = halves[1][25:] = np.nan
    record = RunRecord(configure("fast", {"frames": 2}), points, points, points, points)
    lost = [points, np.full_like(points, np.nan)]
    for name, frames, words in (("all", lost, "in frame 1"), ("halves", halves, "Each particle")):
        with Trajectory(stored(tmp_path / f"{name}.vtkhdf", record, iter(frames))) as run:
            with pytest.raises(MeshError, match=words):
                html.page(Selection(run, (0, 1)))
            assert run._repr_html_() is None


def test_a_single_frame_has_its_surface_if_it_is_asked_for(
    small_result: Path, built: Path, tmp_path: Path
) -> None:
    """As one mesh in which nothing moves."""
    path = export(small_result, tmp_path / "view.html", "html", frames=1, tracked=True)
    page = path.read_text(encoding="utf-8")
    about = json.loads(re.findall(r'id="about">([^<]*)<', page)[0])
    (surface,) = about["surfaces"]
    assert surface["frames"] == [0]
    with Trajectory(small_result) as run:
        expected = reconstruct_surface(run.positions(1), 0.5, cell_over_h=CELL_OVER_H)
        begin = 6 * run.particle_count
    assert (surface["count"], surface["triangles"]) == (
        len(expected.vertices),
        len(expected.faces),
    )
    levels = unpacked(arrays(page)[begin : begin + 6 * surface["count"]], 1, surface["count"])
    step = about["scale"] / html.LEVELS
    found = np.array(about["offset"]) + step * levels[0]
    np.testing.assert_allclose(found, expected.vertices, atol=0.51 * step)


def test_a_file_is_below_15_mb_whatever_it_shows(built: Path, tmp_path: Path) -> None:
    """Many particles that jump at random, which nothing deflates, and a table of many pictures."""
    chance = np.random.default_rng(2)
    points = chance.uniform(-10, 10, (250_000, 3)).astype(np.float32)
    record = RunRecord(
        config=configure("fast", {"frames": 8}),
        source=points,
        target=points,
        source_points=points,
        target_points=points,
        placement=Placement(source=Similarity(), target=Similarity()),
    )
    frames = (chance.uniform(-10, 10, points.shape) for _ in range(8))
    with Trajectory(stored(tmp_path / "noise.vtkhdf", record, frames)) as trajectory:
        page = html.page(Selection(trajectory, tuple(range(8)), timing=Timing(1200, 60)))
    assert 13e6 < len(page.encode()) < 15e6
    assert re.search(r"\(\d+,\d+ shown\)", page)


def test_particles_surface_and_colours_share_what_there_is(built: Path, tmp_path: Path) -> None:
    """A file has as many bytes of them as it may, and no more."""
    chance = np.random.default_rng(3)
    for name, shape in (("ball", (6, 6, 6)), ("egg", (6, 7, 6))):
        mesh = trimesh.creation.icosphere(subdivisions=3)
        mesh.vertices *= shape
        mesh.visual.vertex_colors = chance.integers(0, 256, (len(mesh.vertices), 4), np.uint8)
        mesh.export(tmp_path / f"{name}.ply")
    settings = {"sampling.points_per_cell_edge": 1, "sampling.fit": "none", "frames": 12}
    ball, egg = (load_mesh(tmp_path / f"{name}.ply") for name in ("ball", "egg"))
    record = prepare(ball, egg, configure("fast", settings))
    jumping = (record.source_points * chance.uniform(0.7, 1.3) for _ in range(12))
    with Trajectory(stored(tmp_path / "jumps.vtkhdf", record, jumping)) as trajectory:
        selection = Selection(trajectory, tuple(range(12)), surface=True, tracked=True)
        page = html.page(selection, most_bytes=90_000)
    assert '"colored": true' in page and '"triangles"' in page
    assert 0.9 * 90_000 < len(arrays(page)) <= 90_000


def test_names_are_text(
    small_result: Path, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name cannot end the script it stands in."""
    monkeypatch.setattr(html, "_title", lambda trajectory: "</script><script>alert(1)</script>")
    export(small_result, tmp_path / "view.html", "html")
    text = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "alert(1)" in text and "<script>alert" not in text


def test_fewer_particles_where_there_are_too_many() -> None:
    """Each at most once, always the same ones, from all over."""
    some = html._some(1000, 100)
    assert len(set(some.tolist())) == 100
    np.testing.assert_array_equal(some, html._some(1000, 100))
    assert abs(some.mean() - 499.5) < 100
    np.testing.assert_array_equal(html._some(50, 100), np.arange(50))


def test_viewer_that_is_not_built(
    small_result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An export says how to build it, a notebook shows the object without it."""
    monkeypatch.setattr(html, "VIEWER", tmp_path / "viewer")
    with pytest.raises(ResultError, match="make page"):
        export(small_result, tmp_path / "view.html", "html")
    assert not (tmp_path / "view.html").exists()
    with Trajectory(small_result) as trajectory:
        assert trajectory._repr_html_() is None


def test_the_surface_of_a_small_result_is_quick(small_result: Path) -> None:
    """Of several frames, counted with those between them; of one frame nothing is followed."""
    with Trajectory(small_result) as trajectory:
        assert html.is_quick(trajectory) and html.is_quick(trajectory, [0, -1])
        assert not html.is_quick(trajectory, [1])
