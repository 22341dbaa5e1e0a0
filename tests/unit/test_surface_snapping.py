"""Surfaces drawn to meshes: all of the way where they are near, not at all where they are far."""

import igl
import numpy as np
import pytest
import trimesh

import morph_engine.export.video as video_export
from chamfer_morph.worker.sandbox.derived_files import StoredSurface
from chamfer_morph.worker.tasks.reconstruct_surface import run as store_surface
from morph_engine import configure
from morph_engine.errors import ConfigError
from morph_engine.export import export
from morph_engine.geometry.mesh import Mesh, make_mesh
from morph_engine.geometry.sampling import fit_to_domain, sample_lattice
from morph_engine.geometry.shapes import make
from morph_engine.geometry.surface_reconstruction import (
    Surface,
    deviations,
    reconstruct_surface,
    surface_deviation,
)
from morph_engine.geometry.surface_snapping import snapped_to
from morph_engine.morphing import prepare
from morph_engine.rendering.pictures import video
from morph_engine.results.selection import Selection
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import Trajectory, write_result

H = 0.5
COUNT = 20
"""Frames of the run: two at each end are drawn, and neither of the others."""


def placed(mesh: Mesh, scale: float, along: tuple[float, float, float], at: float) -> Mesh:
    """A mesh stretched and moved, so that it lies somewhere in its user's own coordinates."""
    return make_mesh(scale * mesh.vertices * along + at, mesh.faces, name=mesh.name)


@pytest.fixture(scope="module")
def spool(tmp_path_factory):
    """A ball that becomes an egg halfway, its particles at rest in either, one per unit cell."""
    ball, egg = placed(make("sphere"), 0.1, (1, 1, 1), 37), placed(make("sphere"), 3, (1, 2, 1), -5)
    settings = {"sampling.points_per_cell_edge": 1, "sampling.fit": "volume", "frames": COUNT}
    record = prepare(ball, egg, configure("fast", settings))
    ends = [record.fitted(role)[0].bounds for role in ("source", "target")]
    at_rest = record.source_points * np.float32(np.ptp(ends[1], axis=0) / np.ptp(ends[0], axis=0))
    with Spool.create(tmp_path_factory.mktemp("run") / "egg.vtkhdf", record) as opened:
        for frame in range(COUNT):
            opened.append(frame, at_rest if frame >= COUNT // 2 else record.source_points, {}, ())
        yield opened


@pytest.fixture(scope="module")
def run(spool):
    """The result of that run, open."""
    with Trajectory(write_result(spool, status="complete")) as opened:
        yield opened


def surface(run, frame, *, snap, units="grid"):
    """The surface of a frame."""
    (found,) = Selection(run, (frame,), surface=True, snap=snap, units=units).snapshots()
    return Surface(found.vertices, found.faces)


def distances(surface, mesh):
    """From each vertex of a surface to a mesh [dx], shape [V]."""
    squared, _, _ = igl.point_mesh_squared_distance(
        surface.vertices, mesh.vertices, mesh.faces.astype(np.int64)
    )
    return np.sqrt(squared)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_what_is_near_is_drawn_and_what_is_far_is_not(share):
    """Up to half a spacing a vertex goes its share of the way, beyond a whole one nowhere."""
    corners = np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0.0]])
    plane = Mesh(corners, np.array([[0, 1, 2]], np.int32), "plane", "")
    height = H * np.array([-2, -1, -0.75, -0.5, -0.1, 0, 0.3, 0.5, 0.75, 1, 2])
    vertices = np.stack([np.linspace(-1, 1, len(height)), 0 * height, height], axis=1)
    drawn = snapped_to(Surface(vertices, np.zeros((0, 3), np.int32)), plane, share, H)
    gone = share * np.array([0, 0, 0.5, 1, 1, 1, 1, 1, 0.5, 0, 0])
    expected = np.stack([vertices[:, 0], vertices[:, 1], (1 - gone) * height], axis=1)
    np.testing.assert_allclose(drawn.vertices, expected, atol=1e-12)
    np.testing.assert_array_equal(drawn.vertices[gone == 0], vertices[gone == 0])


def test_a_ball_drawn_to_its_mesh_is_its_mesh():
    """Every vertex on it, closed, its volume and its normals; and the same to the bit again."""
    mesh, _ = fit_to_domain(make("sphere"), mode="volume")
    found = reconstruct_surface(sample_lattice(mesh, spacing=H, jitter="none"), H)
    drawn = snapped_to(found, mesh, 1.0, H)
    assert distances(drawn, mesh).max() < 1e-6
    assert drawn.watertight
    assert drawn.volume == pytest.approx(mesh.volume, rel=1e-3)
    angles = [deviations(each, mesh)[0][1].mean() for each in (drawn, found)]
    assert angles[0] < 0.5 * angles[1]
    np.testing.assert_array_equal(drawn.vertices, snapped_to(found, mesh, 1.0, H).vertices)


def test_edges_and_corners_are_sharp():
    """The surface of a cube's particles is round; drawn to the cube, it all but has its corners."""
    box = trimesh.creation.box((6, 6, 6))
    mesh = make_mesh(box.vertices, box.faces, name="cube")
    found = reconstruct_surface(sample_lattice(mesh, spacing=H, jitter="none"), H)
    drawn = snapped_to(found, mesh, 1.0, H)
    missed = [
        np.linalg.norm(each.vertices - mesh.vertices[:, None], axis=2).min(axis=1).max()
        for each in (drawn, found)
    ]
    assert missed[0] < 0.3 * H < H < missed[1]
    angles = [deviations(each, mesh)[0][1].mean() for each in (drawn, found)]
    assert angles[0] < 0.15 * angles[1]
    assert drawn.volume == pytest.approx(6**3, rel=1e-3)


def test_nothing_folds_at_a_rim():
    """An open cup: beside its rim the nearest points lie inside and outside, by turns."""
    cup = trimesh.creation.annulus(2.6, 3, 4)
    floor = trimesh.creation.cylinder(
        3, 1.2, transform=trimesh.transformations.translation_matrix((0, 0, -2))
    )
    both = trimesh.util.concatenate([cup, floor])
    mesh = make_mesh(both.vertices, both.faces, name="cup")
    found = reconstruct_surface(sample_lattice(mesh, spacing=H, jitter="none"), H)
    drawn = snapped_to(found, mesh, 1.0, H)
    normals = [
        igl.per_face_normals(each.vertices, each.faces.astype(np.int64), np.zeros(3))
        for each in (found, drawn)
    ]
    assert np.einsum("fi,fi->f", *normals).min() > 0
    apart, before = (surface_deviation(each, mesh)["mean"] for each in (drawn, found))
    assert apart < 0.3 * before


@pytest.mark.parametrize("frame", [0, COUNT // 2, COUNT - 1])
def test_the_page_is_handed_what_an_export_has(run, tmp_path, frame):
    """The snapped corners as well as the others; none where a frame is at neither end."""
    file = tmp_path / "surface.npz"
    store_surface(run.path, frame, file)
    stored = StoredSurface.load(file)
    drawn, found = (surface(run, frame, snap=snap) for snap in (True, False))
    np.testing.assert_array_equal(stored.vertices, found.vertices)
    if frame == COUNT // 2:
        assert stored.snapped is None
    else:
        np.testing.assert_array_equal(stored.snapped, drawn.vertices)


def test_the_last_frame_lies_on_the_users_own_mesh(run):
    """In the coordinates of the target's file."""
    drawn, found = (surface(run, COUNT - 1, snap=snap, units="user") for snap in (True, False))
    apart, before = (surface_deviation(each, run.target)["mean"] for each in (drawn, found))
    assert apart < 0.1 * before


@pytest.mark.parametrize(("frame", "role"), [(0, "source"), (COUNT - 2, "target")])
def test_frames_near_the_ends_are_drawn_half_of_the_way(run, frame, role):
    """A frame of the two that are drawn at either end is half of the way from one that is not."""
    drawn, found = (surface(run, frame, snap=snap) for snap in (True, False))
    whole = snapped_to(found, run.run.fitted(role)[0], 1.0, run.config.spacing)
    np.testing.assert_allclose(drawn.vertices, (found.vertices + whole.vertices) / 2, atol=1e-9)
    assert np.linalg.norm(whole.vertices - found.vertices, axis=1).mean() > 1e-3


@pytest.mark.parametrize("frame", [1, COUNT // 2, COUNT - 3])
def test_frames_on_the_way_stay_as_they_are(run, frame):
    """To the bit."""
    drawn, found = (surface(run, frame, snap=snap) for snap in (True, False))
    np.testing.assert_array_equal(drawn.vertices, found.vertices)
    np.testing.assert_array_equal(drawn.faces, found.faces)


def test_a_run_that_was_stopped_is_not_drawn_to_the_target(spool, tmp_path):
    """Its last frame is none of the target's, whatever it looks like; the first is the source's."""
    path = write_result(spool, tmp_path / "partial.vtkhdf", status="partial")
    with Trajectory(path) as partial:
        for frame, changed in ((0, True), (COUNT - 1, False)):
            drawn, found = (surface(partial, frame, snap=snap) for snap in (True, False))
            assert (drawn.vertices != found.vertices).any() == changed


def test_point_clouds_have_no_mesh_to_draw_to(small_result):
    """The surface stays as it is."""
    with Trajectory(small_result) as result:
        drawn, found = (surface(result, 2, snap=snap) for snap in (True, False))
    np.testing.assert_array_equal(drawn.vertices, found.vertices)


def test_exports_and_videos_hand_the_option_on(run, tmp_path, monkeypatch):
    """To the file of a frame, to a video, and from the export of a video to the video."""
    for write, ending, more in (
        (lambda path, **options: export(run, path, "obj", **options), ".obj", {}),
        (lambda path, **options: video(run, path, **options), ".gif", {"size": (64, 48)}),
    ):
        plain, drawn = (
            write(tmp_path / f"{snap}{ending}", frames=[-1], surface=True, snap=snap, **more)
            for snap in (False, True)
        )
        assert plain.read_bytes() != drawn.read_bytes()
    asked = []
    monkeypatch.setattr(video_export, "video", lambda *_, **options: asked.append(options["snap"]))
    for snap in (False, True):
        video_export.GIF.write(Selection(run, (0,), surface=True, snap=snap), tmp_path)
    assert asked == [False, True]


def test_particles_are_not_drawn(run, tmp_path):
    """Without a surface the option is refused, with what to do about it."""
    with pytest.raises(ConfigError, match="`surface`"):
        export(run, tmp_path / "a.ply", "ply", snap=True)
    with pytest.raises(ConfigError, match="`surface`"):
        video(run, tmp_path / "a.gif", snap=True)
    assert not list(tmp_path.iterdir())
