"""The examples run as a user runs them, with little to compute."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh
from PIL import Image

import morph_engine
from morph_engine.errors import ConfigError
from morph_engine.morphing import run as run_record
from morph_engine.results.trajectory import Trajectory

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(script, *arguments, cwd):
    """Run an example; what it prints."""
    outcome = subprocess.run(
        [sys.executable, EXAMPLES / script, *arguments],
        cwd=cwd,
        timeout=600,
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


def test_own_method_shows_up_everywhere_once_it_is_installed(tmp_path):
    """Lists, help, schema, presets and estimate know it and its settings; it reaches the target."""
    installed = tmp_path / "installed"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation",
         "--target", installed, EXAMPLES / "own_method"],
        check=True, timeout=600,
    )  # fmt: skip
    knows_it = os.environ | {"PYTHONPATH": str(installed)}
    require_method("sorted", "Particles walk to target points", "slabs", knows_it, tmp_path)
    out = tmp_path / "sorted.vtkhdf"
    said = morph(
        "run", "sphere", "star", "--method", "sorted", "--frames", "3", "--set", "slabs=10",
        "--points-per-cell-edge", "1", "--out", out, "--json", cwd=tmp_path, env=knows_it,
    )  # fmt: skip
    end = json.loads(said)
    assert end["two_sided"] < 0.1 and end["many_to_one"] > 0.95
    with Trajectory(out) as result:  # this process does not have the method
        assert result.config.method.name == "sorted"
        assert result.config.method.model_dump()["slabs"] == 10
        with pytest.raises(ConfigError, match="no method called 'sorted'"):
            next(iter(run_record(result.run)))


def test_a_method_is_one_file(tmp_path):
    """A file with options and a class, dropped into a copy of the engine, is a method."""
    engine = Path(morph_engine.__file__).parent
    shutil.copytree(engine, tmp_path / "morph_engine", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(EXAMPLES / "own_method" / "sorted_method.py", tmp_path / "morph_engine" / "methods")
    knows_it = os.environ | {"PYTHONPATH": str(tmp_path)}
    require_method("sorted", "Particles walk to target points", "slabs", knows_it, tmp_path)


def morph(*arguments, cwd, env):
    """Run a command of `morph`; what it prints."""
    command = [sys.executable, "-m", "chamfer_morph", *arguments]
    outcome = subprocess.run(command, cwd=cwd, env=env, timeout=600, capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


def require_method(name, summary, setting, env, cwd):
    """Check that a method is known with its settings wherever methods are."""
    assert summary in json.loads(morph("methods", "--json", cwd=cwd, env=env))["methods"][name]
    assert name in morph("run", "--help", cwd=cwd, env=env)
    assert setting in morph("presets", "fast", "--method", name, cwd=cwd, env=env)
    code = (
        "import json; from morph_engine import cost; from morph_engine.config import MorphConfig; "
        f"print(json.dumps([MorphConfig.model_json_schema(), "
        f"cost.estimate(9**5, 9**5, 40, method={name!r}).seconds, "
        "cost.estimate(9**5, 9**5, 40, method='joint').seconds]))"
    )
    outcome = subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, env=env, capture_output=True, text=True, check=True
    )
    schema, seconds, joint_seconds = json.loads(outcome.stdout)
    reference = schema["properties"]["method"]["discriminator"]["mapping"][name]
    options = schema["$defs"][reference.rpartition("/")[2]]
    assert summary in options["description"] and setting in options["properties"]
    assert 0 < seconds < joint_seconds
