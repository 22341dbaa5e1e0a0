"""Colours of mesh files: what a point of a surface looks like, and what no file may do."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from morph_engine import srgb
from morph_engine.geometry import file_colors
from morph_engine.geometry.mesh import load_mesh, shape_of_trimesh
from morph_engine.geometry.mesh_colors import nearest_colors
from morph_engine.ingest import inspect_mesh

ONE_LEVEL = 1.01
"""Of 255, to which colours of files are rounded."""


def ball():
    """A ball of radius 5 with directions of its vertices."""
    shape = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    return shape, shape.vertices / 5.0


def textured(picture, shape=None):
    """A ball under a picture that is projected along z: x to the right, y upwards."""
    shape, directions = (shape, shape.vertices / 5) if shape is not None else ball()
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    uv = (directions[:, :2] * 0.9 + 1) / 2
    shape.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return shape


def gradient(size=64):
    """A picture that is redder to the right and greener towards its top."""
    ramp = np.linspace(30, 220, size)
    red, green = np.meshgrid(ramp, ramp[::-1])
    return Image.fromarray(np.stack([red, green, 0 * red + 90], axis=2).astype(np.uint8))


def written(tmp_path, shape, name):
    """The mesh as it comes back from a file."""
    path = tmp_path / name
    shape.export(path)
    return load_mesh(path)


def seen(mesh, points):
    """sRGB of the nearest points of a mesh, 0 to 255."""
    light = nearest_colors(points, mesh.vertices, mesh.faces, mesh.colors)
    return srgb.to_bytes(light).astype(float)


@pytest.mark.parametrize("name", ["ball.ply", "ball.obj", "ball.glb"])
def test_colours_of_vertices_come_as_they_are_in_the_file(tmp_path, name):
    """PLY and OBJ have sRGB, and glTF linear light, by their specifications."""
    shape, directions = ball()
    colors = np.rint(127.5 * (directions + 1)).astype(np.uint8)
    shape.visual = trimesh.visual.ColorVisuals(shape, vertex_colors=colors)
    mesh = written(tmp_path, shape, name)
    expected = srgb.to_bytes(colors / 255) if name.endswith("glb") else colors
    found = seen(mesh, shape.vertices)
    assert np.abs(found - expected).max() <= ONE_LEVEL


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("kind", ["vertex", "face"])
@pytest.mark.parametrize(
    ("number", "stored", "expected"),
    [
        ("ushort", (65535, 32768, 0), (255, 128, 0)),
        ("uint", (2**32 - 1, 2**31, 0), (255, 128, 0)),
        ("ushort", (255, 128, 0), (255, 128, 0)),
        ("uchar", (255, 128, 0), (255, 128, 0)),
    ],
)
def test_colours_of_more_than_eight_bits(tmp_path, encoding, kind, number, stored, expected):
    """PLY scales them by the largest number of their type; bytes in a larger type are bytes."""
    box = trimesh.creation.box(extents=(4, 4, 4))
    colors = [f"property {number} {name}" for name in ("red", "green", "blue")]
    header = ["ply", f"format {encoding} 1.0", f"element vertex {len(box.vertices)}"]
    header += [f"property float {name}" for name in "xyz"] + colors * (kind == "vertex")
    header += [f"element face {len(box.faces)}", "property list uchar int vertex_indices"]
    header += [*colors * (kind == "face"), "end_header", ""]
    of_vertex, of_face = (stored, ()) if kind == "vertex" else ((), stored)
    rows = [
        *[(*at, *of_vertex) for at in box.vertices],
        *[(3, *face, *of_face) for face in box.faces],
    ]
    if encoding == "ascii":
        content = "\n".join(" ".join(map(str, row)) for row in rows).encode()
    else:
        order = ">" if "big" in encoding else "<"
        code = {"uchar": "B", "ushort": "H", "uint": "I"}[number]
        codes = {"vertex": "3f", "face": "B3i"}
        codes[kind] += f"3{code}"
        counts = len(box.vertices) * ["vertex"] + len(box.faces) * ["face"]
        content = b"".join(
            struct.pack(order + codes[of], *row) for of, row in zip(counts, rows, strict=True)
        )
    (tmp_path / "box.ply").write_bytes("\n".join(header).encode() + content)
    mesh = load_mesh(tmp_path / "box.ply")
    found = seen(mesh, box.triangles_center)
    assert np.abs(found - expected).max() <= ONE_LEVEL


def test_colours_of_faces_change_at_their_edges(tmp_path):
    """Each face of a PLY file has its own."""
    shape = trimesh.creation.box(extents=(4, 4, 4))
    colors = np.random.default_rng(0).integers(0, 256, (len(shape.faces), 3)).astype(np.uint8)
    shape.visual = trimesh.visual.ColorVisuals(shape, face_colors=colors)
    mesh = written(tmp_path, shape, "box.ply")
    assert np.abs(seen(mesh, shape.triangles_center) - colors).max() <= ONE_LEVEL


def test_a_texture_is_seen_between_vertices(tmp_path):
    """At points of the surface, which lie in no vertex, the picture has the colour it has there."""
    mesh = written(tmp_path, textured(gradient()), "ball.glb")
    shape, _ = ball()
    points = shape.triangles_center
    share = (points[:, :2] / 5 * 0.9 + 1) / 2
    expected = np.column_stack([30 + 190 * share, np.full(len(points), 90)])
    # half a pixel of 64 in which 190 levels change, and a level of rounding
    assert np.abs(seen(mesh, points) - expected).max() < 190 / 64 / 2 + 1.5


def test_a_mesh_inside_out_keeps_its_colours(tmp_path):
    """Turning faces turns what is at their corners."""
    shape = textured(gradient())
    upright = written(tmp_path, shape, "upright.glb")
    shape.invert()
    turned = written(tmp_path, shape, "turned.glb")
    assert turned.repairs
    points = ball()[0].triangles_center
    assert np.abs(seen(upright, points) - seen(turned, points)).max() <= ONE_LEVEL


def test_parts_have_textures_of_their_own(tmp_path):
    """Also a part that is mirrored by its place in the scene, which turns its faces."""
    red, blue = (Image.new("RGB", (8, 8), color) for color in ("red", "blue"))
    scene = trimesh.Scene()
    scene.add_geometry(textured(red))
    mirrored = np.diag([-1.0, 1, 1, 1])
    mirrored[0, 3] = 20
    scene.add_geometry(textured(blue), transform=mirrored)
    mesh = written(tmp_path, scene, "two.glb")
    assert seen(mesh, [[0, 0, 5.0], [20, 0, 5.0]]).tolist() == [[255, 0, 0], [0, 0, 255]]


def test_one_grey_is_no_colour(tmp_path):
    """As many programs write where nobody has chosen a colour."""
    shape, _ = ball()
    grey = trimesh.visual.material.PBRMaterial(baseColorFactor=[0.8, 0.8, 0.8, 1.0])
    shape.visual = trimesh.visual.TextureVisuals(material=grey)
    assert written(tmp_path, shape, "grey.glb").colors is None
    shape.visual.material.baseColorFactor = [1.0, 0.0, 0.0, 1.0]
    assert seen(written(tmp_path, shape, "red.glb"), [[0, 0, 5.0]]).tolist() == [[255, 0, 0]]


def test_geometry_is_the_same_with_colours_and_without(tmp_path):
    """To the last bit, so that colours change no result."""
    plain = written(tmp_path, ball()[0], "plain.glb")
    colored = written(tmp_path, textured(gradient()), "colored.glb")
    assert plain.colors is None
    assert np.array_equal(plain.vertices, colored.vertices)
    assert np.array_equal(plain.faces, colored.faces)


def test_a_picture_that_unfolds_to_too_much_is_left_out_unread(tmp_path, monkeypatch):
    """Its size is in its head; a sentence says so and what to do."""
    shape = textured(gradient())
    monkeypatch.setattr(file_colors, "TEXTURE_PIXELS_LIMIT", 64 * 64 - 1)
    mesh = written(tmp_path, shape, "bomb.glb")
    assert mesh.colors is None
    assert mesh.repairs == (
        "A texture of 64 x 64 pixels is too large and has been ignored. Scale it down to use it.",
    )


def test_a_damaged_picture_is_left_out(tmp_path):
    """Its head is right, and its end is missing."""
    file = io.BytesIO()
    gradient().save(file, "PNG")
    path = tmp_path / "torn.glb"
    textured(gradient()).export(path)
    data = bytearray(path.read_bytes())
    begin = data.index(b"\x89PNG") + 60
    data[begin : begin + 40] = bytes(40)
    path.write_bytes(data)
    mesh = load_mesh(path)
    assert mesh.colors is None
    assert "is damaged" in mesh.repairs[0]


def test_a_picture_in_another_file_is_not_looked_for(tmp_path):
    """A file names no other file that is read."""
    picture = tmp_path / "secret.png"
    gradient().save(picture)
    path = tmp_path / "ball.glb"
    textured(gradient()).export(path)
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    header = json.loads(data[20 : 20 + length])
    header["images"] = [{"uri": picture.name}]
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    path.write_bytes(head + text + rest)
    mesh = load_mesh(path)
    assert mesh.colors is None
    assert "in another file" in mesh.repairs[0]


def test_the_report_on_a_mesh_says_where_its_colours_are(tmp_path):
    """At corners, in textures, or nowhere."""
    shape, directions = ball()
    assert inspect_mesh(written(tmp_path, shape, "plain.ply")).colors == "none"
    assert inspect_mesh(written(tmp_path, textured(gradient()), "ball.glb")).colors == "textures"
    colors = np.rint(127.5 * (directions + 1)).astype(np.uint8)
    shape.visual = trimesh.visual.ColorVisuals(shape, vertex_colors=colors)
    assert inspect_mesh(written(tmp_path, shape, "ball.ply")).colors == "corners"


@pytest.mark.parametrize("material", ["PBRMaterial", "SimpleMaterial"])
def test_a_texture_that_was_never_in_a_file(material):
    """A picture made in memory is a texture of an object of trimesh, too."""
    image = Image.new("RGB", (64, 64), (255, 0, 0))
    kind = getattr(trimesh.visual.material, material)
    name = "baseColorTexture" if material == "PBRMaterial" else "image"
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(box.vertices[:, :2], kind(**{name: image}))
    mesh = shape_of_trimesh(box)
    assert mesh.repairs == ()
    assert (mesh.colors.textures[0] == (255, 0, 0)).all()
