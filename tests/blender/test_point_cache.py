"""Exported point caches in Blender."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from morph_engine.export import export
from morph_engine.morphing import morph
from morph_engine.presets import configure
from morph_engine.results.selection import Selection
from morph_engine.results.tracked_surface import track_surface
from morph_engine.results.trajectory import Trajectory
from tests.blender.in_blender import found_in_blender

pytestmark = pytest.mark.blender


def test_a_cache_moves_the_mesh_in_blender(tmp_path):
    """Each frame of the scene shows that frame of the run, its axes as they are in the file."""
    settings = {"frames": 4, "sampling.points_per_cell_edge": 1}
    result = tmp_path / "run.vtkhdf"
    for _ in morph("sphere", "heart", configure("fast", settings), out=result):
        pass
    with zipfile.ZipFile(export(result, tmp_path / "run.zip", "pc2", tracked=True)) as archive:
        archive.extractall(tmp_path)
    cache = tmp_path / "surface.obj", tmp_path / "surface.pc2"
    found = found_in_blender("read_point_cache.py", *cache, 0, 1, 3, folder=tmp_path)
    with Trajectory(result) as run:
        selection = Selection(run, tuple(range(4)), surface=True, tracked=True, units="user")
        (mesh,) = track_surface(selection).meshes
    for frame, places in found.items():
        np.testing.assert_allclose(places, mesh.vertices[int(frame)], atol=1e-4)
