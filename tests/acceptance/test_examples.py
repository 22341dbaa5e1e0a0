"""The examples run as a user runs them, with little to compute."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import trimesh
from PIL import Image

from morph_engine.results.trajectory import Trajectory

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(script, *arguments, cwd):
    """Run an example; what it prints."""
    outcome = subprocess.run(
        [sys.executable, EXAMPLES / script, *arguments],
        cwd=cwd,
        timeout=300,
        capture_output=True,
        text=True,
    )
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


def test_first_morph_leaves_a_result_a_surface_and_a_video(tmp_path):
    """All three open and hold what they should, and VTK makes a picture of the result."""
    run("first_morph.py", "--frames", "2", "--points", "1", cwd=tmp_path)
    folder = tmp_path / "first-morph"
    with Trajectory(folder / "morph.vtkhdf") as result:
        assert (result.status, result.frame_count) == ("complete", 2)
    assert trimesh.load_mesh(folder / "last.glb").is_watertight
    with Image.open(folder / "morph.gif") as video:
        assert video.size == (480, 360)
    run("vtk_picture.py", folder / "morph.vtkhdf", "vtk.png", cwd=tmp_path)
    with Image.open(tmp_path / "vtk.png") as picture:
        assert len(picture.getcolors(picture.width * picture.height)) > 1000  # balls, lit


def test_compare_methods_prints_a_row_each_and_draws(tmp_path):
    """A row of numbers and a panel for each method."""
    options = ("--frames", "1", "--points", "1", "--methods", "physics,dco")
    said = run("compare_methods.py", *options, cwd=tmp_path)
    rows = {line.split()[0]: line.split()[1:] for line in said.splitlines()[1:3]}
    assert list(rows) == ["physics", "dco"]
    assert all(float(number) >= 0 for row in rows.values() for number in row)
    with Image.open(tmp_path / "methods.png") as picture:
        assert picture.size == (960, 360)


def test_own_method_reaches_the_target(tmp_path):
    """In the last frame every particle stands on a target point, each on its own."""
    said = run("own_method.py", "--frames", "3", "--points", "1", cwd=tmp_path)
    first, *_, last = re.findall(r"distance ([\d.]+) dx  distinct ([\d.]+)", said)
    assert float(last[0]) < 0.1 < float(first[0])
    assert float(last[1]) > 0.95
