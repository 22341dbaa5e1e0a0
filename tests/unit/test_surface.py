"""Surfaces: closed, where the shape is, and honest about their distance from it."""

import numpy as np
import pytest

from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import make_mesh
from morph_engine.geometry.sampling import fit_to_domain, sample_lattice
from morph_engine.geometry.shapes import resolve_shape
from morph_engine.geometry.surface_reconstruction import (
    Surface,
    _in_order,
    _without_specks,
    reconstruct_surface,
    surface_deviation,
)

H = 0.5


@pytest.mark.parametrize("shape", ["sphere", "torus"])
def test_surface_of_an_even_fill_lies_where_the_shape_does(shape):
    """Watertight, one body, the volume of the fill, and a tenth of a spacing from the shape."""
    mesh, _ = fit_to_domain(resolve_shape(shape), mode="volume")
    particles = sample_lattice(mesh, spacing=H, jitter="none")
    found = reconstruct_surface(particles, H)
    assert found.watertight
    assert found.bodies == 1
    # the level is set for a sphere at three points per cell edge; this is two, and a torus
    assert found.volume == pytest.approx(len(particles) * H**3, rel=0.02)
    apart = surface_deviation(found, mesh)
    assert max(apart["mean"], apart["mean_back"]) < 0.1 * H
    assert apart["mean"] <= apart["rms"] <= apart["max"] < H


def test_lost_particles_change_nothing(lattice_ball):
    """A particle far away or without a position leaves the surface of the others as it was."""
    ball = lattice_ball(4.0, H)
    lost = np.array([[np.nan, 0, 0], [1e12, 0, 0]], np.float32)
    found, expected = (
        reconstruct_surface(np.concatenate([ball, lost]), H),
        reconstruct_surface(ball, H),
    )
    np.testing.assert_array_equal(found.vertices, expected.vertices)
    np.testing.assert_array_equal(found.faces, expected.faces)


def test_a_frame_has_one_surface(lattice_ball):
    """Twice the same particles give the same surface, to the bit and in the same order."""
    ball = lattice_ball(6.0, H)
    once, again = reconstruct_surface(ball, H), reconstruct_surface(ball, H)
    np.testing.assert_array_equal(once.vertices, again.vertices)
    np.testing.assert_array_equal(once.faces, again.faces)


def test_the_order_of_a_surface_is_its_own(lattice_ball):
    """However its vertices, its faces and their corners come, it is the same surface, as closed."""
    rng = np.random.default_rng(7)
    found = reconstruct_surface(lattice_ball(3.0, H), H)
    new_number = rng.permutation(len(found.vertices))
    corners = np.array([np.roll(face, turn) for turn, face in enumerate(new_number[found.faces])])
    shuffled = _in_order(found.vertices[np.argsort(new_number)], rng.permutation(corners))
    np.testing.assert_array_equal(shuffled.vertices, found.vertices)
    np.testing.assert_array_equal(shuffled.faces, found.faces)
    assert shuffled.watertight
    assert shuffled.volume == found.volume


def test_bodies_and_their_shares(lattice_ball):
    """Two balls apart are two bodies, and the larger one has its share of the area."""
    large, small = lattice_ball(4.0, H), lattice_ball(2.0, H)
    found = reconstruct_surface(np.concatenate([large, small + np.float32([9, 0, 0])]), H)
    assert found.bodies == 2
    # areas go as the radius squared; smoothing takes more from a small ball
    assert found.area_share_of_largest == pytest.approx(16 / 20, abs=0.03)


def test_specks_are_left_out(lattice_ball):
    """What stays of a part smaller than a particle would be is no body."""
    ball = reconstruct_surface(lattice_ball(3.0, H), H)
    speck = np.array([[9, 0, 0], [9.1, 0, 0], [9, 0.1, 0], [9, 0, 0.1]])
    corners = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32) + len(ball.vertices)
    both = Surface(np.concatenate([ball.vertices, speck]), np.concatenate([ball.faces, corners]))
    assert both.bodies == 2
    kept = _without_specks(both, H**2)
    np.testing.assert_array_equal(kept.vertices[kept.faces], ball.vertices[ball.faces])


def test_a_missing_face_is_noticed(lattice_ball):
    """A surface with a hole, or a face turned over, is not watertight."""
    whole = reconstruct_surface(lattice_ball(3.0, H), H)
    turned = whole.faces.copy()
    turned[0] = turned[0][::-1]
    assert whole.watertight
    assert not Surface(whole.vertices, whole.faces[1:]).watertight
    assert not Surface(whole.vertices, turned).watertight


def test_deviation_is_a_distance():
    """Concentric spheres are the difference of their radii apart, both ways."""
    sphere = resolve_shape("sphere")
    radius = np.linalg.norm(sphere.vertices - sphere.vertices.mean(axis=0), axis=1).mean()
    grown = sphere.vertices * (1 + 0.5 / radius)
    found = Surface(grown, sphere.faces)
    apart = surface_deviation(found, make_mesh(sphere.vertices, sphere.faces, name="sphere"))
    for name in ("mean", "rms", "max", "mean_back", "rms_back", "max_back"):
        assert apart[name] == pytest.approx(0.5, abs=0.02), name  # facets are not round


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((5, 3), np.nan)])
def test_nothing_has_no_surface(points):
    """Without particles there is a cause and a remedy."""
    with pytest.raises(MeshError, match="no particles"):
        reconstruct_surface(points, H)
