"""Built-in shapes, and what a user may type for a shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen
from matplotlib.font_manager import FontEntry, fontManager, ttfFontProperty
from matplotlib.ft2font import FT2Font

from morph_engine.errors import MeshError
from morph_engine.geometry.sampling import FIT_HALF_EXTENT, REFERENCE_VOLUME
from morph_engine.geometry.shapes import _heart, make, names, resolve_shape
from morph_engine.geometry.topology import Topology
from morph_engine.geometry.winding_number import inside
from morph_engine.ingest import check_mesh


def parts(mesh):
    """Whether it is watertight, its number of parts and its Euler number."""
    topology = Topology(mesh.vertices, mesh.faces)
    return topology.watertight, topology.component_count, topology.euler


@pytest.mark.parametrize("name", names())
def test_built_in_shapes_fill_the_domain_alike(name):
    """Each is closed, has the volume of the paper's sphere, and lies in the domain."""
    mesh = make(name)
    check_mesh(mesh)
    assert parts(mesh)[0]
    assert mesh.volume == pytest.approx(REFERENCE_VOLUME)
    assert np.abs(mesh.bounds).max() <= FIT_HALF_EXTENT + 1e-9
    np.testing.assert_allclose(mesh.bounds.sum(axis=0), 0, atol=1e-9)
    assert not mesh.repairs


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sphere", (True, 1, 2)),
        ("torus", (True, 1, 0)),
        ("heart", (True, 1, 2)),
        ("star", (True, 1, 2)),
        ("teapot", (True, 4, 8)),
        ("text:A", (True, 1, 0)),
        ("text:B", (True, 1, -2)),
        ("text:Hi", (True, 3, 6)),
    ],
)
def test_parts_and_holes(name, expected):
    """Watertight, parts, Euler number: a B has two holes, an i has a dot."""
    assert parts(make(name)) == expected


def test_heart_satisfies_its_equation():
    """Before the fit to the domain, every vertex lies on Taubin's surface."""
    x, y, z = _heart().vertices.T
    left = (x**2 + y**2 + 9 / 4 * z**2 - 1) ** 3
    np.testing.assert_allclose(left, (x**2 + 9 / 80 * z**2) * y**3, atol=1e-12)


def test_teapot_has_a_handle_and_a_spout():
    """The handle leaves a gap to put fingers through; the spout reaches beyond the body."""
    mesh = make("teapot")
    (left, *_), (right, *_) = mesh.bounds
    line = np.linspace([left, 0.8, 0], [right, 0.8, 0], 400)
    filled = inside(mesh, line)
    assert np.count_nonzero(np.diff(filled.astype(int)) == 1) >= 2


LATIN = ["A", "Hello", "Hello World", "I", "Ångström", "i%&8", "g"]


@pytest.mark.parametrize("text", [*LATIN, "Ωμέγα", "שלום", "شجرة"])
def test_any_text_is_a_solid(text):
    """Letters are closed solids that pass the ingest check."""
    mesh = make(f"text:{text}")
    check_mesh(mesh)
    assert parts(mesh)[0]


def test_long_text_is_set_in_lines():
    """Words are broken into lines, so that the letters stay large."""
    width, height, _ = np.ptp(make("text:one two six").bounds, axis=0)
    assert height > width / 2


def test_text_is_read_from_the_front():
    """An L has its foot to the right and its stem to the left, seen along -z."""
    mesh = make("text:L")
    x, y, _ = mesh.bounds[1] * 0.9
    assert inside(mesh, [[-x, y, 0], [-x, -y, 0], [x, -y, 0], [x, y, 0]]).tolist() == [
        True, True, True, False
    ]  # fmt: skip


def test_a_letter_of_another_font(tmp_path, monkeypatch):
    """What DejaVu lacks is written in an installed font that has it, a bold one before others."""
    _font(tmp_path / "a.ttf", "Regular", [(0, 0), (0, 1000), (1000, 0)])
    _font(tmp_path / "b.ttf", "Bold", [(0, 0), (0, 1000), (1000, 1000), (1000, 0)])
    known = [ttfFontProperty(FT2Font(str(tmp_path / name))) for name in ("a.ttf", "b.ttf")]
    monkeypatch.setattr(fontManager, "ttflist", known)
    square = make("text:\ue8ff")
    x, y, _ = 0.9 * square.bounds[1]
    assert inside(square, [[x, y, 0], [-x, -y, 0]]).all(), "that of the bold one"
    assert parts(make("text:A\ue8ff"))[:2] == (True, 2)


def _font(path: Path, style: str, corners: list[tuple[int, int]]) -> None:
    """Write a font of one letter, U+E8FF."""
    pen = TTGlyphPen(None)
    pen.moveTo(corners[0])
    for corner in corners[1:]:
        pen.lineTo(corner)
    pen.closePath()
    names = [".notdef", "shape"]
    builder = FontBuilder(1000, isTTF=True)
    builder.setupGlyphOrder(names)
    builder.setupCharacterMap({0xE8FF: "shape"})
    builder.setupGlyf(dict.fromkeys(names, pen.glyph()))
    builder.setupHorizontalMetrics(dict.fromkeys(names, (1000, 0)))
    builder.setupHorizontalHeader(ascent=1000, descent=0)
    builder.setupNameTable({"familyName": "Test", "styleName": style})
    builder.setupOS2(usWeightClass=700 if style == "Bold" else 400)
    builder.setupPost()
    builder.save(path)


def test_a_typeface_that_is_gone_is_passed_over(tmp_path, monkeypatch):
    """Matplotlib's list of fonts may be older than the last that was removed."""
    gone = FontEntry(fname=str(tmp_path / "gone.ttf"), name="AAA", weight="bold")
    monkeypatch.setattr(fontManager, "ttflist", [gone])
    with pytest.raises(MeshError, match="No installed font"):
        make("text:\ue8ff")


@pytest.mark.parametrize("text", ["", "   ", "x" * 61, "\ue8ff", "\u2060"])
def test_text_that_cannot_be_drawn(text):
    """Empty, overlong and unknown letters are errors with a remedy."""
    with pytest.raises(MeshError) as caught:
        make(f"text:{text}")
    assert caught.value.remedy


def test_unknown_name_suggests_the_nearest():
    """A typing error is answered by the name that was meant."""
    with pytest.raises(MeshError, match="Did you mean 'teapot'"):
        resolve_shape("teepot")


def test_hopeless_name_lists_all():
    """A name like no other is answered by all names."""
    with pytest.raises(MeshError, match="sphere, torus, heart"):
        resolve_shape("xyzzy")


def test_resolve_reads_files_and_built_ins(tmp_path):
    """A path is read, a bare name is built."""
    path = tmp_path / "triangle.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    assert resolve_shape(str(path)).volume == pytest.approx(1 / 6)
    assert resolve_shape("sphere").name == "sphere"


def test_a_folder_or_a_file_that_is_no_mesh_hides_no_built_in_shape(tmp_path, monkeypatch):
    """An export may have made one of that name."""
    (tmp_path / "star").mkdir()
    (tmp_path / "sphere").touch()
    monkeypatch.chdir(tmp_path)
    assert resolve_shape("star").built_in
    assert resolve_shape("sphere").built_in


def test_same_shape_same_digest():
    """The digest of a built-in shape identifies it."""
    assert make("star").sha256 == make("star").sha256
    assert make("star").sha256 != make("heart").sha256
