"""Normals at the corners of a mesh: the mean of the faces by area, or nothing."""

import numpy as np

from morph_engine.geometry.topology import vertex_normals

CORNERS = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1], [5, 5, 5], [7, 7, 7]], float)
XY, YZ = (0, 1, 2), (0, 2, 3)
"""Faces that look along z and x; the first has twice the area of the second."""


def test_they_are_the_mean_by_area():
    """At the edge that two faces share, the larger one weighs more."""
    normals = vertex_normals(CORNERS, np.array([XY, YZ], np.int32))
    np.testing.assert_allclose(normals[1], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(normals[3], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(normals[[0, 2]], [np.array([1, 0, 2]) / 5**0.5] * 2, atol=1e-12)


def test_without_an_area_they_are_zero():
    """Where there is no face, or one that is only a line; a line adds nothing to a face."""
    normals = vertex_normals(CORNERS, np.array([XY, (0, 4, 5)], np.int32))
    np.testing.assert_allclose(normals[0], [0, 0, 1], atol=1e-12)
    np.testing.assert_array_equal(normals[3:], 0)
