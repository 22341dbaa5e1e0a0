"""Binary PLY files of polygons, written by hand: what a modeller exports, and damaged ones."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest

from morph_engine import srgb
from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.mesh_colors import nearest_colors
from morph_engine.geometry.ply_faces import with_triangles

ORDERS = {"<": "little", ">": "big"}

CODES = {"uchar": "B", "ushort": "H", "short": "h", "int": "i", "uint": "I"}

CORNERS = [(x, y, z) for x in (0, 4) for y in (0, 4) for z in (0, 4)]
"""Of a cube, whose volume is 64."""

SQUARES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]

MIDDLES = [(0, 2, 2), (4, 2, 2), (2, 0, 2), (2, 4, 2), (2, 2, 0), (2, 2, 4)]
"""Of the squares."""

COLORS = [(250, 0, 0), (0, 250, 0), (0, 0, 250), (250, 250, 0), (0, 250, 250), (250, 0, 250)]

EDGE = "element edge 1\nproperty int vertex1\nproperty int vertex2"

MIXED = [*SQUARES[:5], SQUARES[5][:3], (1, 7, 3)]
"""The last square is two triangles; its middle is on the edge between them."""


def ply(order, vertices, faces, edges=b""):
    """A binary PLY file: lines of the header and content, for each element."""
    head = f"ply\nformat binary_{ORDERS[order]}_endian 1.0\ncomment by hand\n"
    lines = "\n".join((vertices[0], faces[0], *([EDGE] * bool(edges))))
    return f"{head}{lines}\nend_header\n".encode() + vertices[1] + faces[1] + edges


def cube_vertices(order, colors=()):
    """The corners of the cube, each with its colour."""
    header = "element vertex 8\nproperty float x\nproperty float y\nproperty float z"
    header += "".join(f"\nproperty uchar {name}" for name in ("red", "green", "blue") if colors)
    rows = zip(CORNERS, colors or [()] * 8, strict=True)
    return header, b"".join(struct.pack(order + "3f", *at) + bytes(color) for at, color in rows)


def polygons(order, faces, colors=(), count="uchar", index="int"):
    """Faces, each with its colour."""
    header = f"element face {len(faces)}\nproperty list {count} {index} vertex_indices"
    header += "".join(f"\nproperty uchar {name}" for name in ("red", "green", "blue") if colors)
    rows = b""
    for corners, color in zip(faces, colors or [()] * len(faces), strict=True):
        codes = f"{order}{CODES[count]}{len(corners)}{CODES[index]}"
        rows += struct.pack(codes, len(corners), *corners) + bytes(color)
    return header, rows


def read(tmp_path, content):
    """The mesh of a file of this content."""
    path = tmp_path / "cube.ply"
    path.write_bytes(content)
    return load_mesh(path)


def seen(mesh, points):
    """sRGB of the nearest points of a mesh."""
    return srgb.to_bytes(nearest_colors(points, mesh.vertices, mesh.faces, mesh.colors)).astype(int)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("count", "index"), [("uchar", "int"), ("ushort", "uint"), ("int", "ushort"), ("int", "short")]
)
def test_triangles_and_quads_in_one_file(tmp_path, order, count, index):
    """Whatever the types of their lists, and with edges behind them."""
    faces = polygons(order, MIXED, count=count, index=index)
    for edges in (b"", struct.pack(order + "2i", 0, 1)):
        mesh = read(tmp_path, ply(order, cube_vertices(order), faces, edges))
        assert mesh.volume == pytest.approx(64)
        assert len(mesh.faces) == 12
        assert mesh.repairs == ()


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("faces", [SQUARES, MIXED], ids=["quads", "mixed"])
def test_polygons_keep_their_colours(tmp_path, order, faces):
    """Each of their triangles has them."""
    colors = [*COLORS, COLORS[-1]][: len(faces)]
    mesh = read(tmp_path, ply(order, cube_vertices(order), polygons(order, faces, colors)))
    assert mesh.volume == pytest.approx(64)
    for shift in (0.5, -0.5):  # on either triangle of the square
        found = seen(mesh, np.array(MIDDLES) + shift * (np.array(MIDDLES) == 2) * (1, -1, 1))
        np.testing.assert_allclose(found, COLORS, atol=1)


@pytest.mark.parametrize("order", ORDERS)
def test_vertices_keep_their_colours(tmp_path, order):
    """As they are in the file."""
    colors = [tuple(60 * c for c in corner) for corner in CORNERS]
    mesh = read(tmp_path, ply(order, cube_vertices(order, colors), polygons(order, MIXED)))
    np.testing.assert_allclose(seen(mesh, CORNERS), colors, atol=1)


def test_a_polygon_of_many_corners(tmp_path):
    """A prism over a hexagon: the two ends have six corners, and its sides four."""
    angles = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = [(*at, z) for z in (0.0, 2.0) for at in ring]
    vertices = (
        "element vertex 12\nproperty float x\nproperty float y\nproperty float z",
        b"".join(struct.pack("<3f", *at) for at in points),
    )
    sides = [(k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6) for k in range(6)]
    faces = [tuple(range(5, -1, -1)), tuple(range(6, 12)), *sides]
    mesh = read(tmp_path, ply("<", vertices, polygons("<", faces)))
    assert mesh.volume == pytest.approx(3 * np.sqrt(3), rel=1e-6)  # float32
    assert len(mesh.faces) == 2 * 4 + 6 * 2


def test_other_lists_and_rows_between_are_passed_over(tmp_path):
    """Places in a texture at each corner, and an element with lists before the faces."""
    rows = b"".join(
        struct.pack(f"<fB{2 * len(face)}fB{len(face)}iB", 0, 2 * len(face), *[0.5] * 2 * len(face),
                    len(face), *face, 200)
        for face in MIXED
    )  # fmt: skip
    header = f"element face {len(MIXED)}\nproperty float quality\n"
    header += "property list uchar float texcoord\nproperty list uchar int vertex_index\n"
    header += "property uchar flags"
    strips = "element strip 2\nproperty list uchar int near\n"
    lists = struct.pack("<B2iB2i", 2, 1, 2, 2, 3, 4)
    mesh = read(tmp_path, ply("<", cube_vertices("<"), (strips + header, lists + rows)))
    assert mesh.volume == pytest.approx(64)


def test_files_that_need_nothing_stay():
    """Triangles, points, texts, and what is no PLY file at all."""
    triangles = [half for a, b, c, d in SQUARES for half in ((a, b, c), (a, c, d))]
    whole = ply("<", cube_vertices("<"), polygons("<", triangles))
    points = ply("<", cube_vertices("<"), ("comment no faces", b""))
    for data in (whole, points, b"ply\nformat ascii 1.0\nend_header\n", b"solid cube", b""):
        assert with_triangles(data) is data


def test_damaged_files_are_refused(tmp_path):
    """Cut short, with lists longer than the file, or of types that there are not."""
    whole = ply("<", cube_vertices("<"), polygons("<", MIXED, count="int"))
    first = whole.index(b"end_header\n") + len(b"end_header\n") + 8 * 12
    longer = whole[:first] + struct.pack("<i", 2**31 - 1) + whole[first + 4 :]
    negative = whole[:first] + struct.pack("<i", -1) + whole[first + 4 :]
    kinds = [whole.replace(b"list int", b"list %s" % name) for name in (b"float", b"half")]
    cut = [whole[:end] for end in (60, first - 1, first + 2, len(whole) - 5)]
    for data in (longer, negative, *kinds, *cut):
        with pytest.raises(ValueError, match=r"ends|unknown type|no end"):
            with_triangles(data)
        with pytest.raises(MeshError, match="not a readable PLY file"):
            read(tmp_path, data)


@pytest.mark.parametrize("number", [b"vertex 4000000000", b"face 4000000000"])
def test_declared_counts_take_no_memory(number):
    """The file has 300 bytes."""
    whole = ply("<", cube_vertices("<"), polygons("<", MIXED))
    old = b"vertex 8" if number.startswith(b"vertex") else b"face 7"
    data = whole.replace(b"element " + old, b"element " + number)
    tracemalloc.start()
    with pytest.raises(ValueError, match="ends"):
        with_triangles(data)
    assert tracemalloc.get_traced_memory()[1] < 1e5
    tracemalloc.stop()


def test_triangles_take_no_more_than_some_times_the_file():
    """Though each of them repeats all numbers of its polygon."""
    numbers = "".join(f"\nproperty double n{k}" for k in range(250))
    face = struct.pack("<H", 2000) + bytes(2000 + 8 * 250)
    header = f"element face 2\nproperty list ushort uchar vertex_indices{numbers}"
    rows = face + struct.pack("<H", 3) + bytes(3 + 8 * 250)
    with pytest.raises(ValueError, match="more corners"):
        with_triangles(ply("<", cube_vertices("<"), (header, rows)))
