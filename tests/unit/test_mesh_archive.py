"""ZIP archives of a mesh and the files that it names, and what no archive may do."""

from __future__ import annotations

import io
import json
import zipfile
from unicodedata import normalize

import numpy as np
import pytest
import trimesh
from PIL import Image

from morph_engine import srgb
from morph_engine.errors import MeshError
from morph_engine.geometry import mesh as mesh_module
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.mesh_colors import nearest_colors

ORANGE, TEAL = (230, 120, 20), (10, 130, 140)


def archive(path, files, **options):
    """A ZIP file of these contents by name."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, **options) as written:
        for name, content in files.items():
            written.writestr(name, content)
    return path


def halves():
    """A picture, the left half of which is orange and the right one teal."""
    pixels = np.full((32, 32, 3), ORANGE, np.uint8)
    pixels[:, 16:] = TEAL
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def box_obj(material="skin"):
    """A box of 4 x 4 x 4 as OBJ; the picture lies along x."""
    box = trimesh.creation.box(extents=(4, 4, 4))
    lines = ["mtllib box.mtl"]
    lines += ["v {} {} {}".format(*vertex) for vertex in box.vertices]
    lines += [f"vt {(vertex[0] + 2) / 4} 0.5" for vertex in box.vertices]
    lines += [f"usemtl {material}"]
    lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in face) for face in box.faces]
    return "\n".join(lines)


def colors_of(mesh, points):
    """sRGB of the nearest points of a mesh."""
    return srgb.to_bytes(nearest_colors(points, mesh.vertices, mesh.faces, mesh.colors))


@pytest.mark.parametrize(
    "reference",
    ["skin.png", "C:\\work\\Textures\\SKIN.PNG", "./textures/skin.png", "-s 1 1 1 skin.png"],
)
def test_an_obj_has_its_picture(tmp_path, reference):
    """However its materials name it."""
    path = archive(
        tmp_path / "box.zip",
        {
            "model/box.obj": box_obj(),
            "model/box.mtl": f"newmtl skin\nKd 0 0 0\nmap_Kd {reference}\n",
            "model/textures/skin.png": halves(),
            "__MACOSX/model/._box.obj": "not a mesh",
        },
    )
    mesh = load_mesh(path)
    assert mesh.repairs == ()
    assert mesh.volume == pytest.approx(64)
    found = colors_of(mesh, [[-1.5, 2, 0.3], [1.5, 2, 0.3]]).astype(int)
    np.testing.assert_allclose(found, [ORANGE, TEAL], atol=1)


def stored_plainly(path):
    """The same archive with its names in UTF-8, but without the flag that says so."""
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\3\4", 7), (b"PK\1\2", 9)):
        at = data.find(signature)
        while at >= 0:
            data[at + offset] &= ~0x08
            at = data.find(signature, at + 1)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_names_with_accents(tmp_path, form):
    """An archive by macOS has them taken apart, and does not say that they are in UTF-8."""
    files = {
        normalize(form, "käse/grün.obj"): box_obj().replace("box.mtl", "grün.mtl"),
        normalize(form, "käse/grün.mtl"): "newmtl skin\nmap_Kd Bilder/häute.png\n",
        normalize(form, "käse/Bilder/häute.png"): halves(),
        normalize(form, "käse/häute.png"): b"another",
    }
    for path in (archive(tmp_path / "flag.zip", files), archive(tmp_path / "plain.zip", files)):
        if path.stem == "plain":
            stored_plainly(path)
        mesh = load_mesh(path)
        assert mesh.repairs == ()
        found = colors_of(mesh, [[-1.5, 2, 0.3], [1.5, 2, 0.3]]).astype(int)
        np.testing.assert_allclose(found, [ORANGE, TEAL], atol=1)


def test_names_in_another_encoding_are_as_the_archive_says(tmp_path):
    """Without a flag they are in code page 437, unless they are in UTF-8."""
    path = archive(tmp_path / "old.zip", {"kase.obj": box_obj(), "kasf.obj": box_obj()})
    path.write_bytes(path.read_bytes().replace(b"kas", b"k\x84s"))  # an ä
    assert "käse.obj and käsf.obj" in refusal(path)


@pytest.mark.parametrize("options", ["", "-s 1 1 1 ", "-o 0 0 -clamp on "])
@pytest.mark.parametrize("folder", ["", "C:\\work\\", "all my textures/"])
def test_a_picture_whose_name_has_spaces(tmp_path, options, folder):
    """The options before it have spaces as well, and there is another picture of its last word."""
    files = {
        "box.obj": box_obj(),
        "box.mtl": f"newmtl skin\nmap_Kd {options}{folder}my skin.png\n",
        "skin.png": b"another",
        "all my textures/my skin.png": halves(),
    }
    mesh = load_mesh(archive(tmp_path / "box.zip", files))
    assert mesh.repairs == ()
    found = colors_of(mesh, [[-1.5, 2, 0.3], [1.5, 2, 0.3]]).astype(int)
    np.testing.assert_allclose(found, [ORANGE, TEAL], atol=1)


def test_a_comment_names_no_materials(tmp_path):
    """Whether a line that does follows, or none."""
    comment = "# made by a tool that writes no mtllib, or one\n  #mtllib other.mtl\r\n"
    box = comment + box_obj().replace("usemtl skin", "usemtl red")
    files = {"box.obj": box, "box.mtl": "newmtl red\nKd 0.8 0.2 0.1\n"}
    mesh = load_mesh(archive(tmp_path / "box.zip", files))
    assert mesh.repairs == ()
    np.testing.assert_allclose(colors_of(mesh, [[0, 2, 0.3]])[0], [204, 51, 26], atol=1)
    files["box.obj"] = box.replace("\nmtllib box.mtl\n", "\n")
    plain = load_mesh(archive(tmp_path / "plain.zip", files))
    assert plain.repairs == ()
    assert plain.colors is None


def test_an_obj_has_the_colours_of_its_materials(tmp_path):
    """`Kd` is sRGB, and a material without it is white."""
    box = box_obj().replace("usemtl skin", "usemtl red")
    files = {"box.obj": box, "box.mtl": "newmtl red\nKd 0.8 0.2 0.1\n"}
    mesh = load_mesh(archive(tmp_path / "box.zip", files))
    np.testing.assert_allclose(colors_of(mesh, [[0, 2, 0.3]])[0], [204, 51, 26], atol=1)


def test_what_is_not_there_is_told(tmp_path):
    """The shape is read all the same."""
    files = {"box.obj": box_obj(), "box.mtl": "newmtl skin\nmap_Kd skin.png\n"}
    mesh = load_mesh(archive(tmp_path / "box.zip", files))
    assert mesh.repairs == ("skin.png is not in the archive and has been ignored.",)
    alone = load_mesh(archive(tmp_path / "alone.zip", {"box.obj": box_obj()}))
    assert alone.colors is None
    assert alone.repairs == ("box.mtl is not in the archive and has been ignored.",)
    (tmp_path / "box.obj").write_text(box_obj())
    lone = load_mesh(tmp_path / "box.obj")
    assert lone.repairs == ("To use the colours of box.mtl, put both files into a ZIP archive.",)


def test_a_gltf_has_its_buffer_and_its_picture(tmp_path):
    """As sites for models give it away: scene.gltf, scene.bin, textures."""
    box = trimesh.creation.box(extents=(4, 4, 4))
    picture = Image.open(io.BytesIO(halves()))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    uv = np.stack([(box.vertices[:, 0] + 2) / 4, np.full(len(box.vertices), 0.5)], axis=1)
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    files = trimesh.Scene(box).export(file_type="gltf")
    header = json.loads(files["model.gltf"])
    assert all(not buffer["uri"].startswith("data:") for buffer in header["buffers"])
    path = archive(tmp_path / "box.zip", files)
    mesh = load_mesh(path)
    assert mesh.volume == pytest.approx(64)
    assert mesh.up == "y"
    found = colors_of(mesh, [[-1.5, 2, 0.3], [1.5, 2, 0.3]]).astype(int)
    np.testing.assert_allclose(found, [ORANGE, TEAL], atol=1)
    del files[header["buffers"][0]["uri"]]
    with pytest.raises(MeshError, match="lacks"):
        load_mesh(archive(tmp_path / "lacking.zip", files))


def test_an_archive_of_a_plain_mesh_is_the_mesh(tmp_path):
    """Whatever its format."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5)
    for kind in ("stl", "ply", "off", "glb", "obj"):
        plain = tmp_path / f"ball.{kind}"
        ball.export(plain)
        mesh = load_mesh(archive(tmp_path / f"{kind}.zip", {plain.name: plain.read_bytes()}))
        expected = load_mesh(plain)
        np.testing.assert_array_equal(mesh.vertices, expected.vertices)
        np.testing.assert_array_equal(mesh.faces, expected.faces)
        assert mesh.up == expected.up


def refusal(path):
    """Why an archive is refused."""
    with pytest.raises(MeshError) as caught:
        load_mesh(path)
    assert caught.value.remedy
    return caught.value.cause


def test_one_archive_holds_one_mesh(tmp_path):
    """Nobody has to guess which is meant."""
    box = box_obj()
    assert "contains no mesh" in refusal(archive(tmp_path / "a.zip", {"read.me": "nothing"}))
    two = archive(tmp_path / "b.zip", {"one.obj": box, "two.obj": box})
    assert "2 meshes, such as one.obj and two.obj" in refusal(two)
    nested = archive(tmp_path / "c.zip", {"box.zip": archive(two, {"a.obj": box}).read_bytes()})
    assert "contains no mesh" in refusal(nested)


def test_archives_that_are_no_archives(tmp_path):
    """Damaged, cut short, or something else."""
    whole = archive(tmp_path / "box.zip", {"box.obj": box_obj()}).read_bytes()
    for number, content in enumerate([b"PK\3\4", whole[:-40], b"solid x" * 9]):
        path = tmp_path / f"{number}.zip"
        path.write_bytes(content)
        assert "not a readable ZIP" in refusal(path)
    damaged = bytearray(whole)
    damaged[60:80] = bytes(20)
    (tmp_path / "damaged.zip").write_bytes(damaged)
    assert "not a readable ZIP" in refusal(tmp_path / "damaged.zip")


def test_an_encrypted_archive_is_told(tmp_path):
    """By the flag that both headers of a file have."""
    data = bytearray(archive(tmp_path / "plain.zip", {"box.obj": box_obj()}).read_bytes())
    for signature, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        data[data.index(signature) + offset] |= 1
    (tmp_path / "secret.zip").write_bytes(data)
    assert "is encrypted" in refusal(tmp_path / "secret.zip")


def test_an_archive_unfolds_to_no_more_than_a_file_may_have(tmp_path, monkeypatch):
    """Whatever sizes it states; and the number of its files is bounded."""
    monkeypatch.setattr(mesh_module, "FILE_BYTES_LIMIT", 2**20)
    bomb = archive(tmp_path / "bomb.zip", {"box.obj": box_obj(), "zeros": bytes(2**21)})
    assert bomb.stat().st_size < 10_000
    assert "contains more than 1 MiB" in refusal(bomb)
    many = archive(tmp_path / "many.zip", {f"{k}.txt": "" for k in range(1001)})
    assert "1001 files" in refusal(many)


def test_an_archive_reads_nothing_outside_of_it(tmp_path):
    """Neither a file on the disk nor one named by an absolute path."""
    (tmp_path / "skin.png").write_bytes(halves())
    (tmp_path / "box.mtl").write_text("newmtl skin\nKd 1 0 0\n")
    for reference in (str(tmp_path / "skin.png"), "../skin.png", "skin.png"):
        materials = f"newmtl skin\nmap_Kd {reference}\n"
        files = {"in/box.obj": box_obj(), "in/box.mtl": materials}
        mesh = load_mesh(archive(tmp_path / "box.zip", files))
        assert mesh.colors is None
        assert "is not in the archive" in mesh.repairs[0]
    assert load_mesh(archive(tmp_path / "bare.zip", {"box.obj": box_obj()})).colors is None
