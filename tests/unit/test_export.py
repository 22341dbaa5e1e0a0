"""Export: every format read back by a library of its own gives what the result holds."""

import csv
import json
import shutil
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from morph_engine.errors import ConfigError, ExtraError, MeshError, ResultError
from morph_engine.export import FORMATS, export, html, suffix
from morph_engine.geometry.surface_reconstruction import reconstruct_surface
from morph_engine.geometry.topology import vertex_normals
from morph_engine.rendering.pictures import video
from morph_engine.results.fields import FIELDS
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import Trajectory, write_result

TOLERANCE = 1e-5  # in the user's units, where the egg is 4 long and 37 from the origin


@pytest.fixture(scope="module")
def trajectory(small_result):
    """The result, open."""
    with Trajectory(small_result) as opened:
        yield opened


def glb_attribute(path, name, dtype, width):
    """Values of the vertices in a GLB file of one primitive, shape [v, width]."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"][name]]
    start = 28 + length + document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    return np.frombuffer(data, dtype, width * accessor["count"], start).reshape(-1, width)


@pytest.mark.parametrize("format", ["ply", "obj", "glb"])
def test_points_come_back(trajectory, tmp_path, format):
    """All particles of the last frame, in order, where the user's own files have them."""
    path = export(trajectory, tmp_path / f"frame.{format}", format)
    cloud = trimesh.load_scene(path).geometry.popitem()[1]
    expected = trajectory.positions_in_user_units(-1)
    np.testing.assert_allclose(cloud.vertices, expected, atol=TOLERANCE)


@pytest.mark.parametrize("format", ["ply", "obj", "glb", "stl"])
def test_surface_comes_back(trajectory, tmp_path, format):
    """The same closed surface, in grid units if asked for."""
    path = export(
        trajectory, tmp_path / f"s.{format}", format, frames=[1], surface=True, units="grid"
    )
    found = trimesh.load_mesh(path)
    expected = reconstruct_surface(trajectory.positions(1), 0.5)
    assert found.is_watertight
    assert len(found.faces) == len(expected.faces)
    np.testing.assert_allclose(
        found.vertices[found.faces], expected.vertices[expected.faces], atol=TOLERANCE
    )


def splats(path):
    """The properties of the Gaussians in a file, by name."""
    cloud = trimesh.load(path)
    return cloud.metadata["_ply_raw"]["vertex"]["data"]


def test_particles_as_splats_fill_the_body(trajectory, tmp_path):
    """Round Gaussians at the particles, half a spacing wide: nowhere inside is there a gap."""
    found = splats(export(trajectory, tmp_path / "s.ply", "splat", units="grid"))
    places = np.stack([found[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(places, trajectory.positions(-1), atol=TOLERANCE)
    sigma = np.exp(found["scale_0"])
    np.testing.assert_allclose(sigma, 0.5 * trajectory.config.spacing, rtol=1e-5)
    opacity = 1 / (1 + np.exp(-found["opacity"]))
    inside = places[::50] + np.random.default_rng(0).uniform(-0.1, 0.1, (len(places[::50]), 3))
    apart = np.linalg.norm(inside[:, None] - places, axis=2) / sigma
    let_through = np.prod(1 - opacity * np.exp(-(apart**2) / 2), axis=1)
    assert let_through.max() < 0.3


def test_splats_of_a_surface_lie_in_it(trajectory, tmp_path):
    """Flat Gaussians whose thin axis is the normal of the surface; light clay where it looks up."""
    path = tmp_path / "s.ply"
    found = splats(export(trajectory, path, "splat", surface=True, units="grid"))
    surface = reconstruct_surface(trajectory.positions(-1), trajectory.config.spacing)
    normals = vertex_normals(surface.vertices, surface.faces)
    turns = np.stack([found[f"rot_{i}"] for i in range(4)], axis=1)
    thin = Rotation.from_quat(turns, scalar_first=True).apply([0, 0, 1])
    np.testing.assert_allclose(thin, normals, atol=1e-5)
    np.testing.assert_allclose(found["scale_2"] - found["scale_0"], np.log(0.1), atol=1e-5)
    up = normals[:, 2] > 0.5
    assert found["f_dc_0"][up].min() > found["f_dc_0"][normals[:, 2] < -0.5].max()


@pytest.mark.parametrize("surface", [False, True])
def test_splats_of_several_frames_are_a_file_each(trajectory, tmp_path, surface):
    """A zip or a folder of files that players show one after the other, each as if alone."""
    options = {"surface": surface, "units": "grid"}
    folder = export(trajectory, tmp_path / "all", "splat", **options)
    names = [f"frame-{frame:04d}.ply" for frame in range(3)]
    assert sorted(path.name for path in folder.iterdir()) == names
    with zipfile.ZipFile(export(trajectory, tmp_path / "all.zip", "splat", **options)) as archive:
        assert archive.namelist() == names
        for frame, name in enumerate(names):
            alone = export(trajectory, tmp_path / name, "splat", frames=[frame], **options)
            assert archive.read(name) == (folder / name).read_bytes() == alone.read_bytes()
            found = splats(alone)
            places = np.stack([found[axis] for axis in "xyz"], axis=1)
            expected = trajectory.positions(frame)
            if surface:
                expected = reconstruct_surface(expected, 0.5).vertices
            np.testing.assert_allclose(places, expected, atol=TOLERANCE)


def test_a_single_frame_and_a_single_field_need_no_list(trajectory, tmp_path):
    """They give the same file as a list of one."""
    alone = export(trajectory, tmp_path / "a.ply", "ply", frames=1, fields="speed")
    listed = export(trajectory, tmp_path / "b.ply", "ply", frames=[1], fields=["speed"])
    assert alone.read_bytes() == listed.read_bytes()


@pytest.mark.parametrize("frames", [np.int64(1), np.arange(1, 2), range(1, 2), np.array(1)])
def test_frames_may_be_numbers_of_numpy(trajectory, tmp_path, frames):
    """They give the same file as a list of Python's own, and the same picture."""
    for name, write in (
        ("ply", lambda path, which: export(trajectory, path, "ply", frames=which)),
        ("png", lambda path, which: video(trajectory, path, frames=which, size=(64, 48))),
    ):
        found = write(tmp_path / f"a.{name}", frames).read_bytes()
        assert found == write(tmp_path / f"b.{name}", [1]).read_bytes()


@pytest.fixture
def all_lost(small_result, tmp_path):
    """A result whose second frame has no particle with a position."""
    path = tmp_path / "lost.vtkhdf"
    with Trajectory(small_result) as run, Spool.create(path, run.run) as spool:
        for frame in range(2):
            places = run.positions(frame)
            spool.append(frame, np.full_like(places, np.nan) if frame else places, {"s2t": 1.0})
        write_result(spool, status="complete")
        spool.remove()
    with Trajectory(path) as opened:
        yield opened


@pytest.mark.parametrize(
    ("name", "format"), [("a.glb", "glb"), ("a.usdc", "usd"), ("a.html", "html"), ("all", "glb")]
)
def test_a_frame_whose_particles_are_all_lost_is_refused(all_lost, tmp_path, name, format):
    """With its number; other frames can be exported."""
    if format == "html" and not html.VIEWER.is_dir():
        pytest.skip("the viewer is not built")
    with pytest.raises(MeshError, match="no particles in frame 1"):
        export(all_lost, tmp_path / name, format)
    assert not (tmp_path / name).exists()
    assert export(all_lost, tmp_path / name, format, frames=[0]).exists()


def test_a_folder_may_have_a_dot_in_its_name(trajectory, tmp_path):
    """What is no ending of a format is none."""
    for name in ("v1.5", "of.monday"):
        assert len(list(export(trajectory, tmp_path / name, "ply").iterdir())) == 3


def test_a_folder_holds_the_frames_of_its_last_export_alone(trajectory, tmp_path):
    """Frames of an earlier one are replaced, files of the user's own are not."""
    folder = export(trajectory, tmp_path / "all", "ply")
    own = {"notes.txt", "frame-0001.blend", "frame-1.ply", "frame-0000.ply.bak"}
    for name in own:
        (folder / name).write_text("mine")
    export(trajectory, folder, "obj", frames=[1, 2])
    assert {path.name for path in folder.iterdir()} == own | {"frame-0001.obj", "frame-0002.obj"}
    video(trajectory, folder, frames=[0], fps=1, size=(64, 48))
    names = {path.name for path in folder.iterdir()}
    assert names == own | {"frame-0000.png", "frame-0001.png"}
    assert all((folder / name).read_text() == "mine" for name in own)


def test_a_folder_stays_as_it_is_if_an_export_fails(trajectory, tmp_path):
    """The frames of the earlier one are there, and no folder is made in vain."""
    folder = export(trajectory, tmp_path / "all", "ply")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def watch(done, total):
        if done == 2:
            raise OSError("The disk is full.")

    for path in (folder, tmp_path / "new"):
        with pytest.raises(ResultError, match="The disk is full"):
            export(trajectory, path, "ply", surface=True, watch=watch)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert not (tmp_path / "new").exists()


def test_a_result_is_never_replaced_by_what_is_made_from_it(small_result, tmp_path):
    """By none of its names, whether it is open or not, in a format of one file or of many."""
    result = tmp_path / "run.vtkhdf"
    shutil.copy(small_result, result)
    (tmp_path / "link.mp4").symlink_to(result)
    (tmp_path / "twin").hardlink_to(result)
    before = result.read_bytes()
    for name, format in (("run.vtkhdf", "npz"), ("run.vtkhdf", "ply"), ("twin", "csv")):
        with pytest.raises(ResultError, match="would replace"):
            export(result, tmp_path / name, format)
    with Trajectory(result) as run, pytest.raises(ResultError, match="would replace"):
        export(run, result, "html")
    for name in ("link.mp4", "twin"):
        with pytest.raises(ResultError, match="would replace"):
            video(result, tmp_path / name)
    assert result.read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"run.vtkhdf", "link.mp4", "twin"}


@pytest.mark.parametrize("format", ["ply", "obj", "glb"])
def test_surfaces_have_normals(trajectory, tmp_path, format):
    """One of each corner, in the corners' order; OBJ has six digits."""
    path = export(trajectory, tmp_path / f"s.{format}", format, frames=[1], surface=True)
    if format == "obj":
        lines = [line.split() for line in path.read_text().splitlines()]
        found = np.array([line[1:] for line in lines if line[0] == "vn"], np.float64)
    elif format == "ply":
        data = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
        found = np.column_stack([data[f"n{axis}"].ravel() for axis in "xyz"])
    else:
        found = glb_attribute(path, "NORMAL", "<f4", 3)
    expected = reconstruct_surface(trajectory.positions(1), 0.5)
    normals = vertex_normals(expected.vertices, expected.faces)
    np.testing.assert_allclose(found, normals, atol=TOLERANCE)


def test_points_of_an_obj_are_one_element(trajectory, tmp_path):
    """Blender warns of each element that it does not show."""
    text = export(trajectory, tmp_path / "p.obj", "obj").read_text()
    element = text[text.index("p ") :].replace("\\\n", "")
    assert element.split() == ["p", *map(str, range(1, trajectory.particle_count + 1))]
    assert max(map(len, text.splitlines())) < 10_000


def test_colours_of_a_glb_are_linear(trajectory, tmp_path):
    """The middle of viridis is (0.13, 0.57, 0.55) as sRGB, and (0.015, 0.28, 0.26) linear."""
    path = export(trajectory, tmp_path / "f.glb", "glb", fields=["displacement"])
    colors = glb_attribute(path, "COLOR_0", "<u2", 4) / 65535
    middle = np.abs(colors[:, :3] - (0.015, 0.28, 0.26)).sum(axis=1).min()
    assert middle < 0.05
    assert (colors[:, 3] == 1).all()


@pytest.mark.parametrize("with_surface", [False, True])
def test_usd_animates(trajectory, tmp_path, with_surface):
    """A time sample per frame, with the points, the triangles and the field of that frame."""
    path = export(trajectory, tmp_path / "egg.usdc", "usd", surface=with_surface, fields=["det_f"])
    stage = Usd.Stage.Open(str(path))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 2)
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    (shape,) = stage.GetDefaultPrim().GetChildren()
    det_f = UsdGeom.PrimvarsAPI(shape).GetPrimvar("det_f")
    for frame in range(3):
        points = np.array(UsdGeom.PointBased(shape).GetPointsAttr().Get(frame))
        np.testing.assert_allclose(det_f.Get(frame), 1 + 0.1 * (frame + 1), rtol=1e-6)
        if with_surface:
            counts = np.array(UsdGeom.Mesh(shape).GetFaceVertexCountsAttr().Get(frame))
            corners = np.array(UsdGeom.Mesh(shape).GetFaceVertexIndicesAttr().Get(frame))
            assert (counts == 3).all()
            found = trimesh.Trimesh(points, corners.reshape(-1, 3), process=False)
            assert found.is_watertight
            normals = np.array(UsdGeom.Mesh(shape).GetNormalsAttr().Get(frame))
            assert np.einsum("vi,vi->v", normals, found.vertex_normals).min() > 0.9
        else:
            expected = trajectory.positions_in_user_units(frame)
            np.testing.assert_allclose(points, expected, atol=TOLERANCE)


def test_npz_holds_arrays(trajectory, tmp_path):
    """Positions and fields of the chosen frames, source and target, all in the same units."""
    path = export(trajectory, tmp_path / "egg.npz", "npz", frames=[2, 0], fields=["displacement"])
    with np.load(path) as arrays:
        assert arrays["frames"].tolist() == [2, 0]
        expected = [trajectory.positions_in_user_units(frame) for frame in (2, 0)]
        np.testing.assert_allclose(arrays["positions"], expected, atol=TOLERANCE)
        moved = np.linalg.norm(arrays["positions"][0] - arrays["source"], axis=1)
        np.testing.assert_allclose(0.5 * arrays["displacement"][0], moved, atol=TOLERANCE)
        assert arrays["target"].shape == (trajectory.particle_count, 3)


def test_csv_is_the_metrics(trajectory, tmp_path):
    """A row per frame, with the frame's index and every metric in full precision."""
    path = export(trajectory, tmp_path / "egg.csv", "csv")
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == [0, 1, 2]
    assert [float(row["s2t"]) for row in rows] == trajectory.metrics["s2t"].tolist()


def test_fields_travel_with_the_points(trajectory, tmp_path):
    """PLY has a property per field; a GLB has colours that follow its first field."""
    ply = trimesh.load(
        export(trajectory, tmp_path / "f.ply", "ply", fields=["displacement", "det_f"])
    )
    data = ply.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(data["det_f"].ravel(), trajectory.det_f(-1))
    moved = np.linalg.norm(trajectory.positions(-1) - trajectory.run.source_points, axis=1)
    np.testing.assert_allclose(data["displacement"].ravel(), moved, atol=TOLERANCE)
    path = export(trajectory, tmp_path / "f.glb", "glb", fields=["displacement"])
    colors = trimesh.load_scene(path).geometry.popitem()[1].colors
    assert (colors[moved == 0] == colors[moved.argmin()]).all()
    assert (colors[moved.argmax()] != colors[moved.argmin()]).any()


def test_many_frames_of_one_kind(trajectory, tmp_path):
    """A zip or a folder has a file per frame; the same zip twice is the same file."""
    told = []
    archive = export(
        trajectory,
        tmp_path / "all.zip",
        "ply",
        frames=[0, -1],
        watch=lambda *done: told.append(done),
    )
    again = export(trajectory, tmp_path / "again.zip", "ply", frames=[0, -1])
    folder = export(trajectory, tmp_path / "all", "ply")
    assert told == [(0, 2), (1, 2), (2, 2)]
    assert archive.read_bytes() == again.read_bytes()
    with zipfile.ZipFile(archive) as files:
        assert files.namelist() == ["frame-0000.ply", "frame-0002.ply"]
        assert files.read("frame-0002.ply") == (folder / "frame-0002.ply").read_bytes()
    assert len(list(folder.iterdir())) == 3


def test_an_ending_in_capitals_is_the_same_ending(trajectory, tmp_path):
    """Bunny.PLY is a file, and no folder of that name."""
    assert export(trajectory, tmp_path / "Egg.PLY", "ply").is_file()
    with zipfile.ZipFile(export(trajectory, tmp_path / "All.ZIP", "ply")) as files:
        assert len(files.namelist()) == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["All.ZIP", "Egg.PLY"]


def test_endings():
    """Several frames of a kind that holds one are a zip; all else has the format's own ending."""
    assert suffix("ply", None) == suffix("ply", [0, 1]) == ".zip"
    assert suffix("ply", [3]) == ".ply"
    assert suffix("usd", None) == ".usdc"
    assert all(known.suffix.startswith(".") for known in FORMATS.values())


@pytest.mark.parametrize(
    ("name", "format", "options", "error", "words"),
    [
        ("a.ply", "plx", {}, ConfigError, "'ply'"),
        ("a.stl", "stl", {}, ConfigError, "surfaces only"),
        ("a.obj", "obj", {"fields": ["speed"]}, ConfigError, "ply"),
        ("a.npz", "npz", {"surface": True}, ConfigError, "not support surfaces"),
        ("a.ply", "ply", {"frames": [0, 1]}, ConfigError, r"\.zip"),
        ("a.ply", "ply", {"frames": [3]}, ResultError, "3 frames"),
        ("a.ply", "ply", {"fields": ["sped"]}, ConfigError, "'speed'"),
        ("missing/a.ply", "ply", {}, ResultError, "Cannot write"),
        ("a.ply", "stl", {"surface": True}, ConfigError, r"contradicts.*\.stl; .*\.zip.*folder"),
        ("a.PLY", "obj", {}, ConfigError, "contradicts"),
        (
            "a.ply",
            "ply",
            {"units": "furlong"},
            ConfigError,
            "'furlong'.*user, source, target, grid",
        ),
        ("a.ply", "ply", {"fields": "sped"}, ConfigError, "'speed'"),
        ("a.csv", "npz", {}, ConfigError, r"contradicts.*\.npz\."),
        ("a.zip", "html", {}, ConfigError, "contradicts"),
        ("a.png", "png", {}, ConfigError, r"contradicts.*\.zip"),
        ("a.vtkhdf", "ply", {}, ConfigError, "contradicts"),
        ("a.usda", "usd", {}, ConfigError, r"contradicts.*\.usdc"),
        ("a.usdz", "usd", {}, ConfigError, r"contradicts.*\.usdc"),
        ("a.splat", "splat", {}, ConfigError, r"contradicts.*\.ply; .*folder"),
        ("a.fbx", "obj", {}, ConfigError, "contradicts"),
        ("a.ply", "ply", {"frames": []}, ConfigError, "No frame"),
        ("a.usdc", "usd", {"fps": 0}, ConfigError, "0 frames per second"),
        ("a.usdc", "usd", {"fps": -24}, ConfigError, "-24 frames per second"),
        ("a.gif", "gif", {"fps": np.nan}, ConfigError, "nan frames per second"),
        ("a.mp4", "mp4", {"fps": np.inf}, ConfigError, "inf frames per second"),
    ],
)
def test_refusals_leave_no_file(trajectory, tmp_path, name, format, options, error, words):
    """What cannot be written is refused with a remedy, and nothing is left behind."""
    with pytest.raises(error, match=words):
        export(trajectory, tmp_path / name, format, **options)
    assert not list(tmp_path.iterdir())


def test_missing_extra_names_the_command(trajectory, tmp_path, monkeypatch):
    """Without usd-core one reads what to install."""
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    with pytest.raises(ExtraError, match=r"pip install 'chamfer-morph\[usd\]'"):
        export(trajectory, tmp_path / "a.usdc", "usd")
    assert not list(tmp_path.iterdir())


def test_documentation_names_every_format_and_field():
    """docs/exports.md has a row for each."""
    text = (Path(__file__).resolve().parents[2] / "docs" / "exports.md").read_text()
    for name in (*FORMATS, *FIELDS):
        assert f"\n| `{name}` |" in text, name
