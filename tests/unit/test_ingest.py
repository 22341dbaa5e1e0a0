"""The ingest report, and what makes a mesh unusable."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from morph_engine.cost import estimate
from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import load_mesh, make_mesh
from morph_engine.geometry.sampling import sample_lattice
from morph_engine.ingest import (
    AMBIGUOUS_LIMIT,
    ambiguous_winding,
    check_mesh,
    fitted,
    inspect_mesh,
)
from morph_engine.morphing import prepare
from morph_engine.presets import configure

MESHES = Path(os.environ.get("MORPH_MESHES", Path(__file__).parents[3] / "shared" / "meshes"))
needs_meshes = pytest.mark.skipif(
    not MESHES.is_dir(), reason="the paper's meshes are not in the folder named by MORPH_MESHES"
)

BALL = trimesh.creation.icosphere(subdivisions=3, radius=7.0)
BOX = trimesh.creation.box(extents=(8.0, 8.0, 8.0))


def as_mesh(*parts):
    """Join trimesh objects into one of our meshes."""
    joined = trimesh.util.concatenate(parts)
    return make_mesh(joined.vertices, joined.faces, name="part")


def without_cap(height):
    """The ball without the faces above a height."""
    kept = BALL.triangles_center[:, 2] < height
    return make_mesh(BALL.vertices, BALL.faces[kept], name="bowl")


def test_report_of_a_closed_mesh():
    """Counts, bounds and Euler number of a box are those of a box."""
    report = inspect_mesh(as_mesh(BOX))
    assert report.watertight
    assert (report.component_count, report.euler, report.open_edge_count) == (1, 2, 0)
    assert report.volume == pytest.approx(512)
    assert report.bounds == ((-4, -4, -4), (4, 4, 4))
    assert report.ambiguous_winding == 0
    assert report.fits_domain
    assert not report.warnings


def test_report_counts_the_published_lattice():
    """The particle counts are those that a run will have."""
    mesh = as_mesh(BOX)
    for resolution in inspect_mesh(mesh).resolutions:
        particles = sample_lattice(mesh, spacing=1 / resolution.points_per_cell_edge)
        assert resolution.particle_count == len(particles)


def test_faces_stored_apart_are_welded():
    """An STL, whose faces share no vertex, is watertight when they meet."""
    apart = make_mesh(BALL.triangles.reshape(-1, 3), np.arange(3 * len(BALL.faces)), name="soup")
    report = inspect_mesh(apart)
    assert report.watertight
    assert (report.component_count, report.euler) == (1, 2)


def test_overlapping_parts_are_not_ambiguous():
    """Where parts overlap the winding number is 2, which is as clear as 1."""
    mesh = as_mesh(BOX, BOX.copy().apply_translation([3.0, 2.0, 1.0]))
    assert inspect_mesh(mesh).component_count == 2
    check_mesh(mesh)


def test_small_hole_is_tolerated():
    """A ball that misses one face can be filled; the report warns."""
    mesh = make_mesh(BALL.vertices, BALL.faces[1:], name="ball")
    check_mesh(mesh)
    report = inspect_mesh(mesh)
    assert not report.watertight
    assert report.open_edge_count == 3
    assert [opening.edge_count for opening in report.openings] == [3]
    assert "not watertight" in report.warnings[0]


def test_open_hemisphere_is_refused_with_the_place_of_its_opening():
    """A bowl has no inside; the message gives centre and size of its rim."""
    with pytest.raises(MeshError, match=r"of 1 openings .* centre \(.*\) and size") as caught:
        check_mesh(without_cap(0.0))
    assert "bowl" in caught.value.cause
    (opening,) = inspect_mesh(without_cap(0.0)).openings
    assert abs(opening.centre[2]) < 1
    np.testing.assert_allclose(opening.size[:2], 14, atol=0.5)  # faces are about 1 long


def test_ambiguity_grows_with_the_opening():
    """The wider the opening, the more points are neither inside nor outside."""
    shares = [ambiguous_winding(without_cap(height)) for height in (7.0, 6.0, 4.0, 0.0)]
    assert shares == sorted(shares)
    assert shares[0] < AMBIGUOUS_LIMIT < shares[-1]


@pytest.mark.parametrize("side", [4.0, 5.0, 6.0, 7.0])
def test_closed_parts_that_overlap_are_unambiguous(side):
    """Also where many points of a lattice over the bounds would lie on the faces of one."""
    parts = [trimesh.creation.icosphere(4, radius=4.0), trimesh.creation.box((side, side, side))]
    both = trimesh.util.concatenate(parts)
    mesh = make_mesh(both.vertices, both.faces, name="both")
    assert ambiguous_winding(mesh) == 0
    check_mesh(mesh)


def test_single_sheet_is_refused():
    """A wavy sheet encloses nothing."""
    x, y = np.meshgrid(np.linspace(-8, 8, 30), np.linspace(-8, 8, 30), indexing="ij")
    index = np.arange(900).reshape(30, 30)
    a, b, c, d = (
        s.ravel() for s in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    vertices = np.stack([x, y, 3 * np.sin(x / 3) + y**2 / 10], axis=-1).reshape(-1, 3)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    with pytest.raises(MeshError, match="neither inside nor outside"):
        check_mesh(make_mesh(vertices, faces, name="sheet"))


def test_reversed_faces_are_turned():
    """A closed surface with half its faces reversed can be filled, and the report says so."""
    faces = np.where(BALL.triangles_center[:, :1] > 0, BALL.faces, BALL.faces[:, ::-1])
    mesh = make_mesh(BALL.vertices, faces, name="ball")
    check_mesh(mesh)
    report = inspect_mesh(mesh)
    assert report.watertight and "pointed inwards and have been flipped" in report.warnings[0]


def test_an_opening_is_told_in_the_coordinates_of_the_file():
    """However a run would scale the mesh, one finds the place in the program it comes from."""
    bowl = without_cap(0.0)
    own = make_mesh(bowl.vertices / 100 + [5, 0, 0], bowl.faces, name="bowl")
    with pytest.raises(MeshError, match=r"centre \(5, .* and size \(0\.14, 0\.14,"):
        check_mesh(fitted(own, "auto")[0], own=own)


def test_cavity_is_kept_and_named():
    """A ball in a box with inward normals is a cavity, and the report says so."""
    cavity = BALL.copy().apply_scale(3 / 7)
    cavity.invert()
    mesh = as_mesh(BOX, cavity)
    report = inspect_mesh(mesh)
    assert mesh.volume == pytest.approx(512 + cavity.volume)
    assert "cavities" in report.warnings[0]


def test_larger_than_the_domain():
    """A mesh a billion wide is refused before any lattice is made, unless it may be scaled."""
    huge = make_mesh(BOX.vertices * 1e8, BOX.faces, name="huge")
    report = inspect_mesh(huge, fit="none")
    assert not report.fits_domain and not report.resolutions
    report = inspect_mesh(huge)
    assert not report.fits_domain and report.resolutions and "scaled" in report.placement
    with pytest.raises(MeshError, match="beyond the domain") as caught:
        check_mesh(huge)
    assert "`sampling.fit`" in caught.value.remedy


def test_too_small_for_500_particles():
    """A unit cube in grid units is refused; the fit is the remedy."""
    with pytest.raises(MeshError, match="fewer than 500 particles") as caught:
        check_mesh(make_mesh(BOX.vertices / 8, BOX.faces, name="cube"))
    assert "`sampling.fit`" in caught.value.remedy


@pytest.mark.parametrize("thickness", [0.3, 0.1])
@pytest.mark.parametrize("fit", ["auto", "volume", "none"])
def test_the_remedy_for_a_needle_works(thickness, fit):
    """What no fit enlarges enough is told how much larger it must be, and in which domain."""
    needle = trimesh.creation.box((20, thickness, thickness))
    mesh = make_mesh(needle.vertices, needle.faces, name="needle")
    with pytest.raises(MeshError, match="fewer than 500 particles") as caught:
        prepare(mesh, "star", configure("fast", {"sampling.fit": fit}))
    remedy = caught.value.remedy
    assert "sampling.fit" not in remedy
    factor, extent, points = (
        float(re.search(pattern, remedy)[1])
        for pattern in (
            r"([\d.]+) times as large",
            r"`grid\.half_extent` to (\d+)",
            r"`sampling\.points_per_cell_edge` to (\d)",
        )
    )
    settings = {
        "sampling.fit": fit, "placement.source.scale": factor, "grid.half_extent": extent,
        "sampling.points_per_cell_edge": int(points),
    }  # fmt: skip
    assert prepare(mesh, "star", configure("fast", settings)).particle_count >= 500


def test_the_remedy_for_a_small_rod_is_the_fit_that_works():
    """Where `auto` leaves a mesh as it is, only `volume` is proposed; and that works."""
    rod = trimesh.creation.box((18, 0.6, 0.6))
    mesh = make_mesh(rod.vertices, rod.faces, name="rod")
    config = {"sampling.points_per_cell_edge": 4}
    with pytest.raises(MeshError) as caught:
        prepare(mesh, "star", configure("fast", config))
    assert caught.value.remedy.endswith("set `sampling.fit` to volume.")
    config["sampling.fit"] = "volume"
    assert prepare(mesh, "star", configure("fast", config)).particle_count >= 500


def test_estimate_grows_with_the_work():
    """More particles or frames cost more; more threads cost less time."""
    small, large = estimate(10_000, 10_000, 40, threads=2), estimate(90_000, 10_000, 40, threads=2)
    assert small.seconds < large.seconds
    assert small.memory_mb < large.memory_mb
    assert estimate(90_000, 10_000, 40, threads=4).seconds < large.seconds


# Watertight, parts and Euler number by algorithm 1.5.
PAPER = {
    "sphere": (True, 1, 2),
    "bunny": (False, 1, -3),
    "duck": (True, 1, 0),
    "cow": (True, 1, 2),
    "teapot": (False, 3, 1),
}


@needs_meshes
@pytest.mark.parametrize("name", PAPER)
def test_paper_meshes_are_usable(name):
    """The paper's meshes pass, holes and overlaps included, with the published topology."""
    mesh = load_mesh(MESHES / f"{name}.obj")
    report = inspect_mesh(mesh)
    assert (report.watertight, report.component_count, report.euler) == PAPER[name]
    check_mesh(mesh)


@needs_meshes
def test_bunny_has_five_holes():
    """The holes of the Stanford bunny are found, and are harmless."""
    report = inspect_mesh(load_mesh(MESHES / "bunny.obj"))
    assert len(report.openings) == 5
    assert 0 < report.ambiguous_winding < 0.01
