"""Meshes of any unit, place and axes run without an option, and come back where they were."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.shapes import make
from morph_engine.results.trajectory import Trajectory

MORPH = Path(sys.executable).with_name("morph")
QUICK = ["--method", "dco", "--points-per-cell-edge", "1", "--frames", "3", "--device", "cpu"]
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def morph(*arguments, cwd):
    """Run the command and capture what it prints."""
    return subprocess.run(
        [MORPH, *map(str, arguments)], cwd=cwd, timeout=300, capture_output=True, text=True
    )


def save(path, name, scale, centre, turn):
    """A built-in shape as a user's file: in other units, elsewhere, on another axis."""
    shape = make(name)
    vertices = (shape.vertices @ turn.T + centre) * scale
    more = {"digits": 12} if path.suffix == ".obj" else {}
    trimesh.Trimesh(vertices, shape.faces, process=False).export(path, **more)


@pytest.mark.parametrize(
    ("scale", "turn"),
    [(0.001, np.eye(3)), (1.0, Z_UP), (1000.0, Z_UP)],
    ids=["mm, y up", "off-centre, z up", "km, z up"],
)
def test_a_mesh_of_any_size_runs_and_comes_back(tmp_path, scale, turn):
    """Heart to teapot, whose spout is thin: the run says what it did, and exports lie at the files.

    The target's points lie in its box to two lattice spacings, and what the run has of the meshes
    is where the files have it to 1e-5 of their size, which is what is asked of it.
    """
    save(tmp_path / "heart.obj", "heart", scale, [40.0, -90.0, 3.0], turn)
    save(tmp_path / "teapot.obj", "teapot", scale, [-40.0, 30.0, 0.0], turn)
    outcome = morph("run", "heart.obj", "teapot.obj", *QUICK, "--out", "r.vtkhdf", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert "scaled by" in outcome.stderr and "--fit none" in outcome.stderr
    assert morph("export", "r.vtkhdf", "-o", "r.npz", cwd=tmp_path).returncode == 0
    exported = np.load(tmp_path / "r.npz")
    with Trajectory(tmp_path / "r.vtkhdf") as result:
        assert [event["kind"] for event in result.events].count("placement") == 1
        spacing = result.config.spacing * exported["transform"][-1, 0, 0]
        for role, share in (("source", 0.0), ("target", 1.0)):
            mesh = load_mesh(tmp_path / f"{getattr(result, role).name}")
            fitted, _ = result.run.fitted(role)
            matrix = result.run.transform_to("user", share)
            back = fitted.vertices @ matrix[:3, :3].T + matrix[:3, 3]
            size = np.ptp(mesh.bounds, axis=0).max()
            np.testing.assert_allclose(back, mesh.vertices, rtol=0, atol=1e-5 * size)
            points = exported[role]
            np.testing.assert_allclose(points.min(axis=0), mesh.bounds[0], atol=2 * spacing)
            np.testing.assert_allclose(points.max(axis=0), mesh.bounds[1], atol=2 * spacing)
        placed = result.positions_in_user_units(-1)
        np.testing.assert_allclose(exported["positions"][-1], placed, rtol=0, atol=1e-9 * size)


def test_shapes_that_stand_on_different_axes_are_turned(tmp_path):
    """A teapot that has z up, as STL does, to a heart with y up, as GLB does: no option is needed.

    The run says that it turns the target, draws upright, and brings both back to 1e-5.
    """
    save(tmp_path / "teapot.stl", "teapot", 1000.0, [40.0, -90.0, 3.0], Z_UP)
    save(tmp_path / "heart.glb", "heart", 0.001, [-40.0, 30.0, 0.0], np.eye(3))
    outcome = morph("run", "teapot.stl", "heart.glb", *QUICK, "--out", "r.vtkhdf", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert "The target is rotated by 90 degrees about x" in " ".join(outcome.stderr.split())
    with Trajectory(tmp_path / "r.vtkhdf") as result:
        run = result.run
        assert run.placement.up == "z"
        for role, points, axes in (
            ("source", run.source_points, [0, 1, 2]),
            ("target", run.target_points, [0, 2, 1]),
        ):
            mesh = load_mesh(tmp_path / getattr(run, role).name)
            extent = np.ptp(mesh.bounds, axis=0)
            shares = np.ptp(points, axis=0) / extent[axes]
            np.testing.assert_allclose(shares, shares.mean(), rtol=0.2)  # a spacing of 1 dx
            matrix = run.transform_to("user", 0.0 if role == "source" else 1.0)
            fitted, _ = run.fitted(role)
            back = fitted.vertices @ matrix[:3, :3].T + matrix[:3, 3]
            np.testing.assert_allclose(back, mesh.vertices, rtol=0, atol=1e-5 * extent.max())


def test_what_is_made_for_the_domain_is_left_alone(tmp_path):
    """Built-in shapes stay as they are, and nothing is said."""
    outcome = morph("run", "heart", "star", *QUICK, "--json", cwd=tmp_path)
    assert "scaled" not in outcome.stderr
    assert not [e for e in json.loads(outcome.stdout)["events"] if e["kind"] == "placement"]


def test_none_takes_a_mesh_as_it_is(tmp_path):
    """A mesh that is too small is refused then, with the option that mends it."""
    save(tmp_path / "small.obj", "heart", 0.05, [0.0, 0.0, 0.0], np.eye(3))
    outcome = morph("run", "small.obj", "star", "--fit", "none", *QUICK, cwd=tmp_path)
    assert outcome.returncode == 2 and "--fit" in outcome.stderr
