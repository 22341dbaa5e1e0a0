"""Reading mesh files: every format, and every way in which a file can be unusable."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import trimesh

from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import FILE_BYTES_LIMIT, load_mesh, make_mesh
from morph_engine.geometry.topology import Topology

BOX = trimesh.creation.box(extents=(6.0, 8.0, 10.0))
FACE_ROWS = "".join(f"f {a} {b} {c}\n" for a, b, c in (BOX.faces + 1).tolist())


def obj(vertices, faces=FACE_ROWS):
    """Text of an OBJ file."""
    return (
        "".join("v " + " ".join(map(str, v)) + "\n" for v in np.asarray(vertices).tolist()) + faces
    )


def glb(header, binary=b""):
    """Bytes of a GLB file."""
    text = json.dumps(header).encode()
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def refusal(path, content):
    """Write a file, and return the error that reading it raises."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(MeshError) as caught:
        load_mesh(path)
    return caught.value


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "off", "glb", "gltf"])
def test_every_format_keeps_file_coordinates(tmp_path, kind):
    """A box written in any format comes back with its bounds and volume."""
    path = tmp_path / f"box.{kind}"
    moved = BOX.copy()
    moved.apply_translation([1.0, 2.0, 3.0])
    if kind == "gltf":
        files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(moved), embed_buffers=True)
        path.write_bytes(files["model.gltf"])
    else:
        moved.export(path)
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.bounds, [[-2, -2, -2], [4, 6, 8]], rtol=1e-6)
    assert mesh.volume == pytest.approx(480, rel=1e-6)  # float32 in STL, PLY and GLB
    assert mesh.name == path.name
    assert len(mesh.sha256) == 64


def test_scene_becomes_one_mesh(tmp_path):
    """The nodes of a GLB scene are placed by their transforms and joined."""
    scene = trimesh.Scene()
    for x in (-5.0, 5.0):
        scene.add_geometry(BOX, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    mesh = load_mesh(path)
    assert mesh.volume == pytest.approx(960, rel=1e-6)
    np.testing.assert_allclose(mesh.bounds[:, 0], [-8, 8], rtol=1e-6)


def test_lines_beside_a_mesh_are_passed_over(tmp_path):
    """As a GLB may have them."""
    scene = trimesh.Scene([BOX, trimesh.load_path([[0, 0, 0], [9, 0, 0], [9, 9, 0]])])
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    assert load_mesh(path).volume == pytest.approx(480, rel=1e-6)


def test_missing_file_names_its_path(tmp_path):
    """A missing file is an error with the path as its cause."""
    with pytest.raises(MeshError, match=r"nowhere\.obj cannot be read: No such file"):
        load_mesh(tmp_path / "nowhere.obj")


def test_folder_is_no_mesh(tmp_path):
    """A folder with the name of a mesh is refused like an unreadable file."""
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(MeshError, match="cannot be read"):
        load_mesh(tmp_path / "folder.obj")


@pytest.mark.parametrize("content", [b"", b" \n\n"])
def test_empty_file(tmp_path, content):
    """An empty file is called empty."""
    assert "is empty" in refusal(tmp_path / "empty.stl", content).cause


def test_unknown_format(tmp_path):
    """A format we cannot read is refused with those we can."""
    error = refusal(tmp_path / "model.step", "ISO-10303-21;")
    assert "known mesh format" in error.cause
    assert "GLB" in error.remedy


def test_oversized_file_is_not_read(tmp_path):
    """A sparse file beyond the limit is refused by its size alone."""
    path = tmp_path / "huge.stl"
    with path.open("wb") as file:
        file.truncate(FILE_BYTES_LIMIT + 1)
    with pytest.raises(MeshError, match="MiB"):
        load_mesh(path)


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "off", "glb", "gltf"])
def test_noise_in_any_format(tmp_path, kind):
    """Random bytes are refused as unreadable or as a mesh without faces."""
    noise = np.random.default_rng(1).bytes(3000)
    assert refusal(tmp_path / f"noise.{kind}", noise).remedy


@pytest.mark.parametrize("kind", ["ply", "stl", "off", "glb"])
def test_truncated_file(tmp_path, kind):
    """A file cut in half is refused."""
    whole = BOX.export(file_type=kind)
    whole = whole.encode() if isinstance(whole, str) else whole
    assert refusal(tmp_path / f"half.{kind}", whole[: len(whole) // 2])


@pytest.mark.parametrize("head", [b"", b"solid box", b"\n solid"])
@pytest.mark.parametrize("appended", [b"\0", b"\r\n", bytes(range(256))])
def test_bytes_after_a_binary_stl_are_ignored(tmp_path, head, appended):
    """Whatever its header says."""
    whole = BOX.export(file_type="stl")
    path = tmp_path / "box.stl"
    path.write_bytes(head.ljust(80, b"\0") + whole[80:] + appended)
    assert load_mesh(path).volume == pytest.approx(480)
    path.write_bytes(BOX.export(file_type="stl_ascii").encode() + b"\n" + bytes(100))
    assert load_mesh(path).volume == pytest.approx(480)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_vertices_must_be_finite(tmp_path, value):
    """NaN and infinite coordinates are counted in the message."""
    vertices = BOX.vertices.astype(str)
    vertices[3, 1] = value
    error = refusal(tmp_path / "nan.obj", obj(vertices))
    assert error.cause == "1 of the 8 vertices of nan.obj are not finite numbers."


@pytest.mark.parametrize("index", ["9", "0", "-9", "99999999999"])
def test_index_out_of_range(tmp_path, index):
    """A face that names a missing vertex is refused; OBJ counts from one."""
    error = refusal(tmp_path / "index.obj", obj(BOX.vertices, FACE_ROWS + f"f 1 2 {index}\n"))
    assert "vertex that does not exist" in error.cause or "not a readable" in error.cause


def test_relative_obj_indices(tmp_path):
    """Indices that count back are counted from where they stand, also if vertices follow."""
    relative = "".join(f"f {a} {b} {c}\n" for a, b, c in (BOX.faces - 8).tolist())
    path = tmp_path / "relative.obj"
    path.write_text(obj(BOX.vertices, relative))
    assert load_mesh(path).volume == pytest.approx(480)
    path.write_text(obj(BOX.vertices, relative) + "v 0 0 0\n")
    assert load_mesh(path).volume == pytest.approx(480)


@pytest.mark.parametrize("scale", [(1.0, 1.0, 0.0), (0.0, 0.0, 0.0)])
def test_no_volume(tmp_path, scale):
    """A flat mesh, or one that is a point, has no volume."""
    assert "no volume" in refusal(tmp_path / "flat.obj", obj(BOX.vertices * scale)).cause


def test_no_faces(tmp_path):
    """A point cloud is not a mesh."""
    assert "no faces" in refusal(tmp_path / "points.obj", obj(BOX.vertices, "")).cause


def test_coordinates_beyond_reason(tmp_path):
    """Coordinates whose squares would lose all digits are refused at once."""
    assert "beyond" in refusal(tmp_path / "far.obj", obj(BOX.vertices * 1e12)).cause


def test_scrambled_indices():
    """Random faces across the whole mesh are refused before they cost minutes of inside tests."""
    random = np.random.default_rng(0)
    with pytest.raises(MeshError, match="as if their indices were scrambled"):
        make_mesh(
            random.uniform(size=(5000, 3)), random.integers(5000, size=(5000, 3)), name="scrambled"
        )


def test_inside_out_mesh_is_turned():
    """A mesh with inward normals is turned, and the report says so."""
    mesh = make_mesh(BOX.vertices, BOX.faces[:, ::-1], name="box")
    assert mesh.volume == pytest.approx(480)
    assert mesh.repairs == ("The surface was inside out and has been flipped.",)


def test_faces_that_disagree_are_turned_outwards(tmp_path):
    """A closed scan with some normals flipped, its triangles apart as in an STL, is the solid."""
    ball, hole = trimesh.creation.icosphere(2, 3.0), trimesh.creation.icosphere(1, 1.0)
    hole.invert()
    flipped = ball.faces.copy()
    flipped[::3] = flipped[::3, ::-1]
    solid = [trimesh.Trimesh(ball.vertices, flipped, process=False), hole]
    trimesh.util.concatenate(solid).export(tmp_path / "scan.stl")
    mesh = load_mesh(tmp_path / "scan.stl")
    assert mesh.repairs == (f"{len(flipped[::3])} faces pointed inwards and have been flipped.",)
    assert mesh.volume == pytest.approx(ball.volume + hole.volume)  # a cavity stays one
    assert hole.volume < 0
    assert Topology(mesh.vertices, mesh.faces).watertight


def test_turned_faces_keep_their_colours(tmp_path):
    """Each corner has the colour that it had, whichever way its face looked."""
    ball = trimesh.creation.icosphere(1, 3.0)
    flipped = ball.faces.copy()
    flipped[::2] = flipped[::2, ::-1]
    shades = np.uint8(np.clip(40 * ball.vertices + 127, 0, 255))
    scan = trimesh.Trimesh(ball.vertices, flipped, vertex_colors=shades, process=False)
    scan.export(tmp_path / "scan.ply")
    mesh = load_mesh(tmp_path / "scan.ply")
    assert mesh.volume == pytest.approx(ball.volume)
    corners = mesh.vertices[mesh.faces]
    assert mesh.colors is not None
    assert np.abs(mesh.colors.corners - np.clip(40 * corners + 127, 0, 255)).max() <= 1


def test_repeated_faces_are_dropped():
    """A face that occurs twice counts once, whichever corner it starts at."""
    repeated = np.concatenate([BOX.faces, np.roll(BOX.faces[:5], 1, axis=1)])
    mesh = make_mesh(BOX.vertices, repeated, name="box")
    assert len(mesh.faces) == 12
    assert mesh.repairs == ("5 duplicate faces have been removed.",)


def test_unused_vertices_do_not_widen_the_bounds():
    """A stray vertex that no face uses is dropped, even if it is not finite."""
    vertices = np.concatenate([BOX.vertices, [[1e6, 0, 0], [np.nan, 0, 0]]])
    mesh = make_mesh(vertices, BOX.faces, name="box")
    np.testing.assert_array_equal(mesh.bounds, [[-3, -4, -5], [3, 4, 5]])


# Files that ask for more than they are ------------------------------------------------------------


def test_gltf_opens_no_other_file(tmp_path):
    """A buffer in another file is refused although that file exists."""
    (tmp_path / "buffer.bin").write_bytes(bytes(1000))
    header = {"asset": {"version": "2.0"}, "buffers": [{"uri": "buffer.bin", "byteLength": 1000}]}
    for kind, content in (("gltf", json.dumps(header)), ("glb", glb(header))):
        assert "another file" in refusal(tmp_path / f"linked.{kind}", content).cause


@pytest.mark.parametrize(
    "accessor", [{"count": 10**12}, {"bufferView": 0, "count": 10**12}, {"count": 3, "sparse": {}}]
)
def test_gltf_declares_more_than_it_holds(tmp_path, accessor):
    """A glTF header cannot make us allocate what is not in the file."""
    header = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"componentType": 5126, "type": "VEC3"} | accessor],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    assert "glTF file" in refusal(tmp_path / "bomb.glb", glb(header, bytes(36))).cause


def test_gltf_shows_one_mesh_a_million_times(tmp_path):
    """Instances count: a small file must not unfold into billions of triangles."""
    header = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"componentType": 5126, "type": "VEC3", "count": 300, "bufferView": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}] * 100_000,
        "scenes": [{"nodes": list(range(100_000))}],
    }
    assert "more data" in refusal(tmp_path / "instances.glb", glb(header, bytes(36))).cause


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        (
            "ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
            b"property float y\nproperty float z\nend_header\n" + bytes(1200),
        ),
        ("ply", b"ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\n"
                b"property float y\nproperty float z\nend_header\n0 0 0\n"),
        ("off", b"OFF\n4000000000 4000000000 0\n0 0 0\n"),
        ("stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(500)),
    ],
)  # fmt: skip
def test_declared_counts_are_not_believed(tmp_path, kind, content):
    """A header that promises four billion elements is refused by what follows it."""
    assert refusal(tmp_path / f"bomb.{kind}", content).remedy
