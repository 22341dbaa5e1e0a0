"""Inside test, lattice sampling and the fit to the domain."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from morph_engine.errors import MeshError
from morph_engine.geometry import sampling
from morph_engine.geometry.mesh import load_mesh, make_mesh
from morph_engine.geometry.sampling import (
    FIT_HALF_EXTENT,
    REFERENCE_VOLUME,
    Similarity,
    fit_to_domain,
    sample_lattice,
)
from morph_engine.geometry.shapes import make
from morph_engine.geometry.winding_cells import open_edges
from morph_engine.geometry.winding_number import FAST_WINDING_ERROR, inside, winding_number

MESHES = Path(os.environ.get("MORPH_MESHES", Path(__file__).parents[3] / "shared" / "meshes"))
needs_meshes = pytest.mark.skipif(
    not MESHES.is_dir(), reason="the paper's meshes are not in the folder named by MORPH_MESHES"
)


def box(*extents):
    """A box about the origin."""
    shape = trimesh.creation.box(extents=extents)
    return make_mesh(shape.vertices, shape.faces, name="box")


@pytest.mark.parametrize("name", ["sphere", "teapot", "text:g%"])
def test_fast_winding_number_equals_the_exact_one(name):
    """Away from the surface the tree approximation is within its stated error."""
    mesh = make(name)
    points = np.random.default_rng(0).uniform(-13, 13, (3000, 3))
    exact = igl.winding_number(mesh.vertices, mesh.faces.astype(np.int64), points)
    clear = np.abs(exact - np.rint(exact)) < 1e-6
    assert clear.mean() > 0.99
    difference = np.abs(winding_number(mesh, points) - exact)[clear]
    assert difference.max() < FAST_WINDING_ERROR


@pytest.mark.parametrize(("size", "offset"), [(1e-14, 0.0), (1e7, 0.0), (1.0, 1e6)])
def test_winding_number_at_any_size_and_place(size, offset):
    """Tiny, huge and far meshes have an inside too; libigl alone does not end on the tiny one."""
    mesh = make("star")
    moved = make_mesh(mesh.vertices * size + offset, mesh.faces, name="moved")
    points = np.array([[0.0, 0.0, 0.0], [0.0, 9.0, 0.0], [9.0, 9.0, 0.0]])
    np.testing.assert_allclose(winding_number(moved, points * size + offset), [1, 1, 0], atol=0.02)


def test_inside_decides_doubtful_points_exactly(monkeypatch):
    """A point that the fast winding number puts on the wrong side is put right."""
    mesh = make("sphere")
    monkeypatch.setattr(
        "morph_engine.geometry.winding_number.winding_number",
        lambda mesh, points: np.array([0.49, 0.51]),
    )
    assert inside(mesh, [[0, 0, 0], [13, 0, 0]]).tolist() == [True, False]


def test_holes_and_overlaps_have_an_inside():
    """A box without one of its 12 triangles, and two boxes in one another, are filled."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=6)
    holed = make_mesh(ball.vertices, ball.faces[1:], name="holed")
    double = trimesh.util.concatenate([ball, ball.copy().apply_translation([2.0, 0.0, 0.0])])
    assert inside(holed, [[0, 0, 0], [0, 0, 9]]).tolist() == [True, False]
    overlapping = make_mesh(double.vertices, double.faces, name="double")
    assert winding_number(overlapping, [[1, 0, 0]]) == pytest.approx(2, abs=0.02)
    assert inside(overlapping, [[1, 0, 0]]).all()


@pytest.mark.parametrize("degenerate", [lambda a, b: [a, a, b], lambda a, b: [a, a, a]])
def test_faces_without_area_change_no_inside(degenerate, monkeypatch):
    """At the rim of a hole, where the edges of such a face are open."""
    mesh = holed_ball()
    middles, _ = open_edges(mesh.vertices, mesh.faces)
    rim = np.argsort(np.linalg.norm(mesh.vertices - middles[0], axis=1))[:2]
    faces = np.vstack([mesh.faces, [degenerate(*rim)]])
    other = make_mesh(mesh.vertices, faces, name="with a degenerate face")
    points = np.random.default_rng(0).uniform(*mesh.bounds, (40_000, 3))
    each = inside(mesh, points)
    monkeypatch.setattr("morph_engine.geometry.winding_number.FEWEST_IN_CELLS", 1)
    monkeypatch.setattr("morph_engine.geometry.winding_number.FEWEST_PER_FACE", 0)
    np.testing.assert_array_equal(inside(other, points), each)


def test_points_in_one_place_have_an_inside(monkeypatch):
    """Without a warning, too."""
    monkeypatch.setattr("morph_engine.geometry.winding_number.FEWEST_IN_CELLS", 1)
    monkeypatch.setattr("morph_engine.geometry.winding_number.FEWEST_PER_FACE", 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert inside(make("sphere"), np.zeros((100, 3))).all()


def holed_ball():
    """A ball without a cap of its surface, and without a triangle elsewhere."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=6)
    kept = ball.triangles_center[:, 2] < 5
    kept[0] = False
    return make_mesh(ball.vertices, ball.faces[kept], name="holed")


@pytest.mark.parametrize("name", ["torus", "star", "text:g%", "holed", "soup"])
def test_cells_give_the_inside_of_their_points(name, monkeypatch):
    """Points that share a winding number with others are where they are by their own."""
    if name == "soup":  # of triangles that share no edge
        star = make("star")
        corners = star.vertices[star.faces].reshape(-1, 3)
        mesh = make_mesh(corners, np.arange(len(corners)).reshape(-1, 3), name="soup")
    else:
        mesh = holed_ball() if name == "holed" else make(name)
    drawn = np.random.default_rng(0).uniform(*mesh.bounds, (40_000, 3))
    axes = np.linspace(*mesh.bounds, 41).T  # on which surface and centres of cells may lie
    for points in (drawn, np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)):
        each = inside(mesh, points)
        with monkeypatch.context() as patched:
            patched.setattr("morph_engine.geometry.winding_number.FEWEST_IN_CELLS", 1)
            patched.setattr("morph_engine.geometry.winding_number.FEWEST_PER_FACE", 0)
            np.testing.assert_array_equal(inside(mesh, points), each)


@needs_meshes
@pytest.mark.parametrize(
    ("name", "count"),
    [("sphere", 37644), ("bunny", 31428), ("duck", 36166), ("cow", 25792), ("teapot", 44497)],
)
def test_published_counts(name, count):
    """The lattice has as many particles as the authors' program (algorithm 1.5)."""
    assert len(sample_lattice(load_mesh(MESHES / f"{name}.obj"), spacing=1 / 3)) == count


def test_published_lattice_by_hand():
    """First points of the lattice of a box against the definition, coordinate by coordinate.

    1608637542, 3421126067, 4083286876 are the first draws of a 32-bit Mersenne twister seeded
    with 42; they move z, y and x of the first point.
    """
    mesh = box(8, 8, 8)
    first = next(sampling._published_lattice(mesh, 0.5))[0]
    draws = np.array([4083286876, 3421126067, 1608637542]) / 2**32
    expected = -4 + (2 * draws - 1) * 0.05
    np.testing.assert_allclose(first, expected, rtol=1e-6)  # float32


def test_published_lattice_starts_at_the_corner():
    """One more point per axis than cells, each within a tenth of the spacing of its site."""
    mesh = box(8, 6, 7)
    points = np.concatenate(list(sampling._published_lattice(mesh, 0.5)))
    assert len(points) == 17 * 13 * 15
    sites = np.indices((17, 13, 15)).reshape(3, -1).T * 0.5 - [4, 3, 3.5]
    assert np.abs(points - sites).max() <= 0.05 * (1 + 1e-5)  # float32 rounding


def test_chunks_do_not_change_the_particles(monkeypatch):
    """Sampling in small chunks draws the same random numbers."""
    mesh = make("heart")
    whole = sample_lattice(mesh, spacing=0.5)
    monkeypatch.setattr(sampling, "CHUNK", 1000)
    np.testing.assert_array_equal(sample_lattice(mesh, spacing=0.5), whole)


def test_even_lattice_is_centred_and_exact():
    """Without jitter a box holds volume / spacing^3 particles, half a spacing inside its walls."""
    points = sample_lattice(box(8, 6, 7), spacing=0.5, jitter="none")
    assert points.dtype == np.float32
    assert len(points) == 16 * 12 * 14
    np.testing.assert_array_equal(points.min(axis=0), [-3.75, -2.75, -3.25])
    np.testing.assert_array_equal(points.max(axis=0), [3.75, 2.75, 3.25])


def test_even_lattice_keeps_symmetry():
    """The even filling of a mirror-symmetric shape is its own mirror image."""
    points = sample_lattice(make("sphere"), spacing=0.5, jitter="none")
    rows = {tuple(row) for row in np.round(points, 3).tolist()}
    mirrored = {tuple(row) for row in np.round(points * [-1, 1, 1], 3).tolist()}
    assert len(rows & mirrored) > 0.99 * len(rows)  # the icosphere is symmetric up to rounding


def test_too_few_particles():
    """A mesh with room for a handful of particles is refused, unless that is asked for."""
    with pytest.raises(MeshError, match="fewer than 500"):
        sample_lattice(box(2, 2, 2), spacing=0.5)
    assert len(sample_lattice(box(2, 2, 2), spacing=0.5, jitter="none", minimum_count=1)) == 64


def test_lattice_of_a_huge_mesh_is_refused():
    """A bounding box 1e9 wide is refused by arithmetic, not by running out of memory."""
    with pytest.raises(MeshError, match="lattice of more than"):
        sample_lattice(box(1e9, 1e9, 1e9), spacing=0.25)


def test_fit_none_keeps_coordinates():
    """`none` returns the mesh itself."""
    mesh = box(8, 8, 8)
    fitted, similarity = fit_to_domain(mesh, mode="none")
    assert fitted is mesh
    assert similarity == Similarity()


def test_fit_extent_spans_the_domain():
    """`extent` gives the longest side its length and centres the bounding box."""
    mesh = make_mesh(box(1, 2, 4).vertices + 100, box(1, 2, 4).faces, name="far")
    fitted, _ = fit_to_domain(mesh, mode="extent")
    np.testing.assert_allclose(fitted.bounds[1], np.array([0.25, 0.5, 1]) * FIT_HALF_EXTENT)
    np.testing.assert_allclose(fitted.bounds[0], -fitted.bounds[1])


def test_fit_volume_equalises_volumes():
    """`volume` gives a mesh the volume of the paper's sphere."""
    fitted, _ = fit_to_domain(box(0.1, 0.2, 0.3), mode="volume")
    assert fitted.volume == pytest.approx(REFERENCE_VOLUME)


def test_fit_volume_of_a_needle_stays_in_the_domain():
    """A long thin mesh gets the largest volume that fits."""
    fitted, _ = fit_to_domain(box(1, 1, 100), mode="volume")
    assert fitted.bounds[1, 2] == pytest.approx(FIT_HALF_EXTENT)
    assert fitted.volume < REFERENCE_VOLUME


@given(
    scale=st.floats(1e-3, 1e3),
    offset=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
    point=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
)
def test_similarity_inverse(scale, offset, point):
    """User coordinates come back from grid units to float64 rounding."""
    similarity = Similarity(scale, offset)
    back = similarity.inverse().apply(similarity.apply(point))
    np.testing.assert_allclose(back, point, atol=1e-9 * (1 + 1e3 / scale))


def test_fitted_particles_return_to_user_coordinates():
    """The inverse of the stored map puts a result back around the user's mesh."""
    mesh = make_mesh(box(1, 1, 1).vertices + 5, box(1, 1, 1).faces, name="cube")
    fitted, similarity = fit_to_domain(mesh, mode="volume")
    particles = similarity.inverse().apply(sample_lattice(fitted, spacing=0.5, jitter="none"))
    assert particles.min() > 4.5
    assert particles.max() < 5.5
