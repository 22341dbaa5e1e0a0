"""What `morph` takes as a shape from Python, and what it says about all else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from morph_engine import Mesh, Trajectory, configure, morph
from morph_engine.errors import ConfigError, MeshError
from morph_engine.morphing import prepare

CONFIG = configure("fast", {"sampling.points_per_cell_edge": 2})
CLOUD = np.random.default_rng(0).uniform(-4, 4, (800, 3))
BOX = trimesh.creation.box((6.0, 6.0, 6.0))
MESH = Mesh(np.array(BOX.vertices), np.array(BOX.faces, np.int32), "box", "ab12")


@pytest.mark.parametrize(
    "points",
    [
        CLOUD.tolist(),
        tuple(map(tuple, CLOUD.tolist())),
        CLOUD.astype(object),
        trimesh.PointCloud(CLOUD),
    ],
    ids=["list", "tuple", "objects", "trimesh"],
)
def test_points_come_in_any_form(points: Any) -> None:
    """A cloud is the same whatever holds its numbers, and can be stored."""
    record = prepare(points, "sphere", CONFIG)
    np.testing.assert_array_equal(record.source_points, CLOUD.astype(np.float32))
    assert record.document() == prepare(CLOUD, "sphere", CONFIG).document()


@pytest.mark.usefixtures("float32_device")
def test_a_list_of_points_is_written_to_a_result(tmp_path: Path) -> None:
    """A nested list as source can be stored with the run."""
    config = configure("fast", {"method": "dco", "frames": 1})
    list(morph(CLOUD.tolist(), CLOUD[::-1], config, out=tmp_path / "r.vtkhdf"))
    with Trajectory(tmp_path / "r.vtkhdf") as result:
        np.testing.assert_array_equal(result.source, CLOUD)


@pytest.mark.parametrize("shape", [BOX, trimesh.Scene(BOX)], ids=["mesh", "scene"])
def test_a_mesh_of_trimesh_is_filled_as_any_other(shape: Any) -> None:
    """Meshes and scenes of trimesh become particles, and keep what they were."""
    record = prepare(shape, "sphere", CONFIG)
    expected = prepare(MESH, "sphere", CONFIG)
    np.testing.assert_array_equal(record.source_points, expected.source_points)


def test_a_mesh_of_trimesh_keeps_its_colours() -> None:
    """Colours of vertices come along, and trimesh's own mesh has them still."""
    box = BOX.copy()
    box.visual.vertex_colors = np.tile([[200, 10, 30, 255]], (8, 1))
    source = prepare(box, "sphere", CONFIG).source
    assert isinstance(source, Mesh)
    assert source.colors is not None
    assert (source.colors.corners == [200, 10, 30]).all()
    assert box.visual.kind == "vertex"


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (None, "type NoneType is no shape"),
        (7, "type int is no shape"),
        (trimesh.Scene(), "has no faces"),
        ([[1, 2, 3], [1, 2]], "no array of numbers"),
        ([["a", "b", "c"]], "no array of numbers"),
        (CLOUD + 1j, "no array of numbers"),
        (replace(MESH, vertices=MESH.vertices * np.nan), "not finite"),
        (replace(MESH, faces=MESH.faces + 1), "a vertex that does not exist"),
        (replace(MESH, faces=MESH.faces - 1), "a vertex that does not exist"),
        (replace(MESH, faces=MESH.faces[:0]), "has no faces"),
        (replace(MESH, faces=MESH.faces[:, :2]), "triangles of shape"),
        (replace(MESH, faces=MESH.faces + 0.5), "not integers"),
        (replace(MESH, vertices=np.array(["a"])), "not arrays of numbers"),
    ],
)
def test_what_is_no_shape_is_refused(shape: Any, words: str) -> None:
    """The error says what is wrong with it."""
    with pytest.raises(MeshError, match=words):
        prepare(shape, "sphere", CONFIG)


def test_a_mesh_of_lists_gets_its_types() -> None:
    """Vertices and faces may be lists, or of other numeric types."""
    lists: Any = replace(MESH, vertices=MESH.vertices.tolist(), faces=MESH.faces.tolist())
    source = prepare(lists, "sphere", CONFIG).source
    assert isinstance(source, Mesh)
    assert (source.vertices.dtype, source.faces.dtype) == (np.float64, np.int32)


@pytest.mark.parametrize("target", [CLOUD.tolist(), tuple(CLOUD), list(CLOUD)])
def test_a_list_of_rows_is_one_target(target: Any) -> None:
    """Rows of numbers are points of one target; clouds in a list are several."""
    record = prepare("sphere", target, CONFIG)
    assert record.leg_count == 1
    np.testing.assert_array_equal(record.target_points, CLOUD.astype(np.float32))
    assert prepare("sphere", [target, CLOUD.tolist()], CONFIG).leg_count == 2


def test_settings_are_no_configuration() -> None:
    """A mapping in its place is refused, with the call that makes one."""
    settings: Any = {"frames": 2}
    with pytest.raises(ConfigError, match=r"is a dict.*configure\(\.\.\.\)"):
        next(morph("sphere", "star", settings))
