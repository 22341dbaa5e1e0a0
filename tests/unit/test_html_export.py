"""The viewer's file: what is packed comes out again, and names are text."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest

from morph_engine.errors import ResultError
from morph_engine.export import export, html
from morph_engine.results.tracked_surface import TrackedMesh, TrackedSurface
from morph_engine.results.trajectory import Trajectory


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


def test_names_are_text(
    small_result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name cannot end the script it stands in."""
    (tmp_path / "viewer.js").write_text("start()")
    for name in ("viewer.css", "licenses.txt"):
        (tmp_path / name).write_text("")
    monkeypatch.setattr(html, "VIEWER", tmp_path)
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
