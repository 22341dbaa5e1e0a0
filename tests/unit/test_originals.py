"""The paper's meshes as made from their originals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from chamfer_morph.reproduction.meshes import ASSETS
from chamfer_morph.reproduction.originals import RECIPES, build, write_mesh
from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import load_mesh, make_mesh

CORNERS = {
    "bunny": [
        (-0.0378297, 0.12794, 0.00447467),
        (-0.0447794, 0.128887, 0.00190497),
        (-0.0680095, 0.151244, 0.0371953),
        (-0.00228741, 0.13015, 0.0232201),
    ],
    "duck": [
        (-0.0689691, -0.271823, -0.0665855),
        (-0.0430436, -0.271803, -0.128743),
        (-0.218892, -0.0311053, -0.287217),
        (-0.854034, 0.200358, -0.114129),
    ],
    "cow": [
        (0.348799, -0.334989, -0.0832331),
        (0.313132, -0.399051, 0.881192),
        (0.266758, 0.181628, 0.122726),
        (0.460287, 0.727236, -0.177367),
    ],
    "teapot": [(-3, 1.8, 0), (-2.9916, 1.8, -0.081), (-2.98945, 1.666162, 0), (-2.985, 1.92195, 0)],
}
"""Some corners of each original, in its own coordinates."""


@pytest.mark.parametrize("name", CORNERS)
def test_corners_of_an_original_land_on_corners_of_the_papers(name, paper_mesh):
    """To the six decimals of the paper's files, in single precision."""
    tetrahedron = make_mesh(CORNERS[name], [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)], name=name)
    placed = RECIPES[f"{name}.obj"].build(tetrahedron)
    distance, _ = KDTree(load_mesh(paper_mesh(name)).vertices).query(placed.vertices)
    assert distance.max() < 3e-6


def test_each_mesh_of_the_paper_has_a_recipe():
    """In the same order."""
    assert list(RECIPES) == list(ASSETS)


@pytest.mark.parametrize("name", [name for name, each in RECIPES.items() if not each.original])
def test_what_needs_no_file_is_made_within_the_papers_bounds(name, tmp_path):
    """The sphere is the paper's; heart and letters stand in. Both times the same bytes."""
    for path in (tmp_path / "a.obj", tmp_path / "b.obj"):
        write_mesh(build(name, RECIPES[name], None), path)
    assert (tmp_path / "a.obj").read_bytes() == (tmp_path / "b.obj").read_bytes()
    mesh = load_mesh(tmp_path / "a.obj")
    np.testing.assert_allclose(mesh.bounds, ASSETS[name].bounds, atol=1e-3)
    assert not mesh.repairs
    assert RECIPES[name].stands_in == (name != "sphere.obj")


def test_a_mesh_that_lies_elsewhere_is_refused():
    """Triangles, volume and area alone would not tell."""
    recipe = RECIPES["sphere.obj"]
    with pytest.raises(MeshError, match="different bounding box"):
        build("bunny.obj", recipe, None)
