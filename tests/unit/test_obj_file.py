"""OBJ files as exporters write them: marks, comments, tabs, forms of faces and indices."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest
import trimesh
from PIL import Image

from morph_engine.geometry.mesh import load_mesh

BOX = trimesh.creation.box(extents=(6.0, 8.0, 10.0))
CORNERS = [" ".join(map(str, row)) for row in BOX.vertices.tolist()]
FACES = [" ".join(map(str, row)) for row in (BOX.faces + 1).tolist()]


def lines(vertex="v {}", face="f {}"):
    """The box, each line as a pattern has it."""
    written = [vertex.format(row) for row in CORNERS] + [face.format(row) for row in FACES]
    return "\n".join(written) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + lines(),
        lines("v {} # corner", "f {} # 0 -1"),
        lines("v\t{}", "f\t{}"),
        lines("  v {}", "\t f {}"),
        lines().replace("\n", "\r\n"),
    ],
    ids=["mark", "comments", "tabs", "indented", "windows"],
)
def test_lines_of_any_look(tmp_path, text):
    """The same box whatever stands around the numbers."""
    path = tmp_path / "box.obj"
    path.write_text(text + "v 0 0 9\n", encoding="utf-8", newline="")
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.bounds, BOX.bounds)
    assert mesh.volume == pytest.approx(480)


def prism(cap, side):
    """A prism on a hexagon, its caps and its sides by a form of corners each."""
    angles = np.arange(6) * np.pi / 3
    rows = [f"v {np.cos(a)} {np.sin(a)} {z}" for z in (0, 1) for a in angles]
    rows += ["vt 0.5 0.5", "vn 0 0 1"]
    polygon = [" ".join(cap.format(i) for i in order) for order in (range(6, 0, -1), range(7, 13))]
    for i in range(6):
        a, b = i + 1, (i + 1) % 6 + 1
        polygon += [" ".join(side.format(k) for k in (a, b, b + 6))]
        polygon += [" ".join(side.format(k) for k in (a, b + 6, a + 6))]
    return "\n".join([*rows, *(f"f {corners}" for corners in polygon)]) + "\n"


@pytest.mark.parametrize("cap", ["{}", "{}/1", "{}//1", "{}/1/1"])
@pytest.mark.parametrize("side", ["{}", "{}/1", "{}//1", "{}/1/1"])
def test_faces_of_several_forms(tmp_path, cap, side):
    """A hexagon of six numbers beside triangles of six, and every other pair."""
    path = tmp_path / "prism.obj"
    path.write_text(prism(cap, side))
    assert load_mesh(path).volume == pytest.approx(1.5 * 3**0.5)


def picture():
    """A PNG, red on the left and blue on the right."""
    image = Image.new("RGB", (64, 64), (255, 0, 0))
    image.paste((0, 0, 255), (32, 0, 64, 64))
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def archive(path, **files):
    """A ZIP file of a mesh, its materials and their pictures."""
    with zipfile.ZipFile(path, "w") as written:
        for name, content in files.items():
            written.writestr(name.replace("_", "."), content)
    return path


def test_texture_coordinates_that_count_back(tmp_path):
    """Each face has its own coordinates before it: all of the box is red."""
    rows = [f"v {row}" for row in CORNERS]
    for face in FACES:
        corners = [f"{corner}/{k - 3}" for k, corner in enumerate(face.split())]
        rows += ["vt 0.2 0.5", "vt 0.3 0.5", "vt 0.2 0.6", "f " + " ".join(corners)]
        rows += ["vt 0.9 0.9"]
    mesh = load_mesh(
        archive(
            tmp_path / "box.zip",
            box_obj="mtllib box.mtl\nusemtl red\n" + "\n".join(rows) + "\n",
            box_mtl="newmtl red\nmap_Kd red.png\n",
            red_png=picture(),
        )
    )
    places = mesh.colors.uv[mesh.colors.texture_of >= 0]
    assert len(places) == 12 and places[..., 0].max() < 0.5


def test_colours_of_vertices_beside_a_plain_material(tmp_path):
    """They are what is seen, as without the material."""
    text = "".join(f"v {row} 1 0 {k % 2}\n" for k, row in enumerate(CORNERS))
    text += "usemtl plain\n" + "".join(f"f {row}\n" for row in FACES)
    (tmp_path / "alone.obj").write_text(text)
    alone = load_mesh(tmp_path / "alone.obj")
    files = {"box_obj": "mtllib box.mtl\n" + text, "box_mtl": "newmtl plain\nKd .8 .8 .8\n"}
    zipped = load_mesh(archive(tmp_path / "box.zip", **files))
    np.testing.assert_array_equal(zipped.colors.corners, alone.colors.corners)
