"""Crossings of triangles against the winding numbers at both ends of a path."""

import igl
import numpy as np
import pytest

from morph_engine.geometry.crossings import Cones, count_crossings
from morph_engine.geometry.shapes import make

TRIANGLE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])


def crossings(ends, triangles):
    """What all these triangles change along paths from the origin."""
    cones = Cones.behind(np.asarray(triangles, float))
    first = np.zeros(len(ends), int)
    return count_crossings(np.asarray(ends, float), first, first + len(triangles), cones, 1e-3)


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("name", ["star", "torus", "text:&"])
def test_crossings_change_the_winding_number(name, flipped):
    """Along random paths, through any number of triangles, from inside and outside."""
    mesh = make(name)
    faces = mesh.faces[:, ::-1] if flipped else mesh.faces
    drawn = np.random.default_rng(0)
    for start in drawn.uniform(*mesh.bounds, (20, 3)):
        ends = drawn.uniform(*mesh.bounds, (200, 3))
        change, doubtful = crossings(ends - start, mesh.vertices[faces] - start)
        winding = igl.winding_number(
            mesh.vertices, faces.astype(np.int64), np.vstack([start, ends])
        )
        sure = ~doubtful
        assert sure.mean() > 0.9 or doubtful.all()  # all, where it begins at a triangle's plane
        np.testing.assert_array_equal(change[sure], np.rint(winding[1:] - winding[0])[sure])


def test_the_winding_number_falls_along_the_normal():
    """A path that leaves by a triangle loses one, and one that enters by it gains one."""
    ends = [[0.2, 0.2, 2.0], [0.2, 0.2, 0.9], [2.0, 2.0, 2.0], [-0.2, -0.2, -2.0]]
    assert crossings(ends, [TRIANGLE])[0].tolist() == [-1, 0, 0, 0]
    assert crossings(ends, [TRIANGLE[::-1]])[0].tolist() == [1, 0, 0, 0]


@pytest.mark.parametrize(
    ("end", "triangle"),
    [
        ([1.0, 1.0, 2.0], TRIANGLE),  # through an edge
        ([0.0, 0.0, 2.0], TRIANGLE),  # through a corner
        ([0.2, 0.2, 1.0], TRIANGLE),  # ends on it
        ([0.2, 0.2, 2.0], TRIANGLE * [1, 1, 1e-4]),  # begins on it, within float32
        ([0.2, 0.2, 2.0], TRIANGLE[[0, 1, 1]]),  # it has no area
    ],
)
def test_paths_that_touch_are_left_open(end, triangle):
    """Rounding would decide whether they cross."""
    assert crossings([end], [triangle])[1].all()
