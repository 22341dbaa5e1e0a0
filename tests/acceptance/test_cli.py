"""The installed `morph` command as a user meets it: real processes, real files, real signals."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from typer.main import get_group

from chamfer_morph.cli import app
from morph_engine.geometry.shapes import names

MORPH = Path(sys.executable).with_name("morph")


def morph(*arguments, cwd=None, timeout=600):
    """Run the command and capture what it prints."""
    return subprocess.run(
        [MORPH, *map(str, arguments)], cwd=cwd, timeout=timeout, capture_output=True, text=True
    )


def assert_refused(outcome, *words):
    """Exit status 2, two lines (cause and remedy), no traceback, and each word said."""
    assert outcome.returncode == 2, outcome.stderr
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 2, outcome.stderr
    assert all(line.endswith(".") for line in lines), outcome.stderr
    for word in words:
        assert word in outcome.stderr


def test_help_names_every_command():
    """`morph --help` and `morph` alone list the commands."""
    for outcome in (morph("--help"), morph()):
        assert outcome.returncode == 0
        for command in ("run", "inspect", "metrics", "shapes", "presets", "methods", "rerun"):
            assert command in outcome.stdout


def test_help_needs_no_taichi():
    """Help does not pay for the engine's heavy imports."""
    code = "import sys, chamfer_morph.cli.app as c; c.app(['--help'], standalone_mode=False); "
    code += "sys.exit(' '.join({'taichi', 'scipy', 'trimesh', 'h5py', 'numpy'} & set(sys.modules)))"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert outcome.stderr.strip() == ""


def test_a_command_imports_its_own_module_only():
    """`morph shapes` does not pay for the commands beside it."""
    code = "import sys, chamfer_morph.cli.app as c; c.app(['shapes'], standalone_mode=False); "
    code += "sys.exit(' '.join(name for name in sys.modules if '.cli.commands.' in name))"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert outcome.stderr.split() == ["chamfer_morph.cli.commands.catalog"]


def test_every_command_is_where_the_table_says():
    """The table that commands are found by names each command of each module, and its module."""
    defined = {
        name: module
        for module in set(app.COMMANDS.values())
        for name in get_group(import_module(f"chamfer_morph.cli.commands.{module}").app).commands
    }
    assert defined == app.COMMANDS


def test_shapes_are_those_of_the_library():
    """`morph shapes --json` lists what `morph run` accepts."""
    assert json.loads(morph("shapes", "--json").stdout)["shapes"] == list(names())


def test_inspect_reports_what_a_run_will_need():
    """The ingest report has counts for each resolution, time and memory."""
    report = json.loads(morph("inspect", "torus", "--json").stdout)
    assert report["watertight"] and report["euler"] == 0 and report["fits_domain"]
    counts = [entry["particle_count"] for entry in report["resolutions"]]
    # a lattice of spacing 1/n holds about volume * n^3 points; the skin makes it a few % off
    assert counts == pytest.approx([report["volume"] * n**3 for n in (2, 3, 4)], rel=0.05)
    assert all(entry["estimate"]["seconds"] > 0 for entry in report["resolutions"])


def test_inspect_of_a_huge_mesh_reports_and_refuses(tmp_path):
    """A mesh beyond the domain is scaled; with --fit none it is described and refused."""
    path = tmp_path / "huge.obj"
    path.write_text(tetrahedron(scale=100.0))
    outcome = morph("inspect", path)
    assert outcome.returncode == 0 and "scaled" in outcome.stdout
    outcome = morph("inspect", path, "--fit", "none")
    assert "volume" in outcome.stdout
    assert_refused(outcome, "--fit")
    report = json.loads(morph("inspect", path, "--fit", "none", "--json").stdout)
    assert not report["fits_domain"] and "--fit" in report["error"]["remedy"]


def test_metrics_of_two_shapes_as_json():
    """A shape fills itself perfectly, and the reference set is named with the numbers."""
    outcome = morph("metrics", "sphere", "sphere", "--points-per-cell-edge", 2, "--json")
    document = json.loads(outcome.stdout)
    assert document["two_sided"] == 0 and document["f1"] == 1 and document["iou"] == 1
    assert document["reference"] == "volume"


def test_metrics_of_a_path_need_a_result():
    """A shape has no path."""
    assert_refused(morph("metrics", "sphere", "--path"), "sphere")


@pytest.mark.parametrize("more", [["star"], ["--frame", "-1"], ["--tau", "0.2"]])
def test_metrics_of_a_path_take_nothing_else(more):
    """Also what would be the default: all frames are measured against the run's own target."""
    assert_refused(morph("metrics", "a.vtkhdf", *more, "--path"), "--path")


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("missing.obj", None, "missing.obj"),
        ("empty.obj", b"", "empty.obj"),
        ("points_only.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "face"),
        ("nan.obj", b"v 0 0 nan\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\nf 1 2 4\n", "nan.obj"),
        ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "index.obj"),
        ("flat.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n", "flat.obj"),
        ("noise.glb", bytes(range(256)), "noise.glb"),
        ("shape.xyzzy", b"hello", "format"),
    ],
)
def test_bad_mesh_files_are_refused_with_cause_and_remedy(tmp_path, name, content, word):
    """Each bad file: exit status 2, one sentence each for cause and remedy, no traceback."""
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert_refused(morph("inspect", path), word)


def test_errors_under_json_are_one_object(tmp_path):
    """A script reads the cause and the remedy from standard output."""
    outcome = morph("inspect", tmp_path / "missing.obj", "--json")
    assert outcome.returncode == 2
    assert set(json.loads(outcome.stdout)["error"]) == {"cause", "remedy"}


@pytest.mark.parametrize(
    "arguments", [["nope"], ["metrics"], ["metrics", "a", "--tau", "x"], ["inspect", "a", "--nope"]]
)
def test_usage_errors_point_to_help(arguments):
    """A mistyped command or option gives two lines, the second naming --help."""
    assert_refused(morph(*arguments), "--help")


def tetrahedron(scale):
    """OBJ text of a closed tetrahedron with edges along the axes."""
    corners = [(0, 0, 0), (scale, 0, 0), (0, scale, 0), (0, 0, scale)]
    faces = [(1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4)]
    return "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(
        f"f {a} {b} {c}\n" for a, b, c in faces
    )
