"""Measures of the path and of its end, on small cases whose answers are known."""

import math

import numpy as np
import pytest
import scipy
import trimesh

from morph_engine.comparison import measure_path
from morph_engine.errors import ResultError
from morph_engine.geometry.mesh import make_mesh
from morph_engine.geometry.shapes import resolve_shape
from morph_engine.geometry.surface_reconstruction import Surface, surface_euler
from morph_engine.metrics import body
from morph_engine.metrics.body import Body, body_surface, measure_body
from morph_engine.metrics.definitions import METRICS
from morph_engine.metrics.independent import Reference, mesh_metrics, surface_metrics
from morph_engine.metrics.path import (
    gap_metrics,
    geodesic_distortion,
    motion_metrics,
    nearest_labels,
    neighbor_metrics,
    over_schedule,
    part_transfer,
    path_metrics,
    settled_share,
    volume_metrics,
)

H = 0.5
RADIUS = 0.87 * H
LENGTH = 48.0
TURN = scipy.spatial.transform.Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()


@pytest.fixture(scope="module")
def ball(lattice_ball):
    """A ball of 2 103 particles, off the lattice enough that no two distances are equal."""
    points = lattice_ball(4.0, H).astype(np.float64)
    return points + np.random.default_rng(0).uniform(-0.05, 0.05, points.shape)


def test_a_rigid_motion_changes_nothing(ball):
    """Neighbours, gaps, area and shortest paths go with the matter."""
    frames = [ball, ball + 1, ball @ TURN + 2]
    m = path_metrics(frames, H)
    assert m["d2_min"] == pytest.approx(0, abs=1e-20)
    assert m["kept"] == 1
    assert m["gap_min"] == pytest.approx(gap_metrics(ball, H)["gap_min"])
    assert (m["more_pieces"], m["more_euler"]) == (0, 0)
    # 1 %: other particles are the nodes of the graph, and other nodes those of the raster
    assert m["geodesic"] < 0.015
    assert [m["area_min"], m["area_max"]] == pytest.approx([1, 1], abs=0.01)
    assert [m["volume_min"], m["volume_max"]] == pytest.approx([1, 1], abs=0.01)


def test_volumes_of_an_affine_motion_are_its_determinant(ball):
    """By positions as by gradients, whatever the direction; gradients that lie are found."""
    moved, grown = ball @ np.diag([1.2, 1.2, 1.2]) @ TURN, 1.2**3
    there = np.full(len(ball), grown)
    m = volume_metrics(ball, moved, there, (H, 1.2 * H))
    assert m["local_volume"] == pytest.approx(1)
    assert m["det_f_off"] == pytest.approx(0, abs=1e-9)
    sheared = ball @ np.array([[1, 0.3, 0], [0, 1, 0], [0, 0, 1]])
    assert volume_metrics(ball, sheared, np.ones(len(ball)), (H, H))["det_f_off"] < 0.02
    lying = volume_metrics(ball, moved, np.ones(len(ball)), (H, 1.2 * H))
    assert lying["det_f_off"] == pytest.approx(1 - 1 / grown)
    corner = np.array([[0, 0, 0], [H, 0, 0], [0, H, 0]])
    assert volume_metrics(corner, corner, np.ones(3), (H, H)) == {}, "none is inside"


def test_lost_particles_take_no_part(ball):
    """A particle without a position leaves the measures of the others as they were."""
    frames = [ball, ball @ TURN]
    lost = [np.append(frame, [[np.nan, 0, 0]], axis=0) for frame in frames]
    assert path_metrics(lost, H, settled=np.ones(len(lost[0]))) == path_metrics(
        frames, H, settled=np.ones(len(ball))
    )


def test_a_path_without_particles_has_the_worst_values():
    """Infinite where lower is better, but 1 for a share; 0 elsewhere, and 0 for counts; no NaN."""
    m = path_metrics([np.full((20, 3), np.nan)] * 3, H, settled=np.ones(20), det_f=np.ones(20))
    assert m == {
        **dict.fromkeys(("area_min", "area_max", "volume_min", "volume_max"), 0),
        **dict.fromkeys(("more_pieces", "more_euler", "kept", "gap_p01", "gap_min"), 0),
        **dict.fromkeys(("d2_min", "geodesic", "detour", "action"), math.inf),
        "settled": 1,
    }


def test_only_crumbs_count_as_more_pieces(lattice_ball):
    """Two balls that meet on the way are no more pieces than at the ends; one that parts is."""
    small = lattice_ball(2.0, H).astype(np.float64)
    one, two = (np.concatenate([small, small + np.array([x, 0, 0])]) for x in (3.0, 9.0))
    assert path_metrics([two, one, two], H)["more_pieces"] == 0
    assert path_metrics([one, two, one], H)["more_pieces"] == 1
    assert path_metrics([one, two], H)["more_pieces"] == 0


def test_an_affine_motion_is_no_shuffling(ball):
    """D2min takes the best affine motion away; neighbours along the stretch are lost."""
    m = neighbor_metrics(ball, ball @ np.diag([2.0, 0.5, 1.0]) @ TURN, H)
    assert m["d2_min"] == pytest.approx(0, abs=1e-20)
    assert m["kept"] < 0.7


def test_shuffling_of_a_known_size(ball):
    """Places of variance s^2 that know nothing of the start leave what no affine map explains.

    Relative places of 12 neighbours have covariance s^2 (I + 11^T) per axis, of which the affine
    map takes the projection P on their places at the start.
    """
    s = 3.0
    neighbours = scipy.spatial.cKDTree(ball).query(ball, 13)[1][:, 1:]
    rest = ball[neighbours] - ball[:, None]
    ones = np.ones((12, 1))
    left = [1 - (r @ np.linalg.pinv(r) @ ones)[:, 0] for r in rest]
    expected = 3 * s**2 / 12 * (9 + np.sum(left, axis=1)) / H**2
    cloud = np.random.default_rng(1).normal(0, s, ball.shape)
    m = neighbor_metrics(ball, cloud, H)
    # each particle's residual has the spread of some 20 squares, shared with its neighbours
    error = 4 * np.sqrt(2 / 20) * np.sqrt(12 / len(ball))
    assert m["d2_min"] == pytest.approx(np.mean(expected), rel=error)
    assert m["kept"] < 0.02  # 12 in 2103 by chance


def test_coincident_particles_have_neighbours():
    """Particles on one spot count as neighbours of each other, not of themselves."""
    assert neighbor_metrics(np.zeros((20, 3)), np.zeros((20, 3)), H)["d2_min"] == 0
    assert gap_metrics(np.zeros((2, 3)), H) == {"gap_p01": 0, "gap_min": 0}


def test_body_of_balls():
    """Separate particles are spheres; a ring of them is a torus, and a far one is still a piece."""
    pair = measure_body([[0, 0, 0], [3, 0, 0]], H, steps_per_h=8)
    assert (pair.pieces, pair.euler) == (2, 4)
    # marching cubes cut off the caps between nodes: 1.5 % of a radius of 7 steps
    assert pair.area == pytest.approx(2 * 4 * np.pi * RADIUS**2, rel=0.015)
    assert pair.volume == pytest.approx(2 * 4 / 3 * np.pi * RADIUS**3, rel=0.015)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.stack([3 * np.cos(angle), 3 * np.sin(angle), 0 * angle], axis=1)
    assert (measure_body(ring, H).pieces, measure_body(ring, H).euler) == (1, 0)
    assert measure_body([*ring, [1e6, 0, 0], [np.nan, 0, 0]], H).pieces == 2


def test_a_body_may_lie_anywhere(ball):
    """Beyond the usual domain as in it: a domain may be of any size."""
    there = measure_body(ball + 96.0, H)  # 576 steps of the raster
    here = measure_body(ball, H)
    # distances are float32 numbers in steps
    assert (there.area, there.volume) == pytest.approx((here.area, here.volume), rel=1e-5)
    assert (there.pieces, there.euler) == (here.pieces, here.euler)


def test_strays_cost_no_memory(ball):
    """A particle far off is one more ball; its raster would have 10^12 nodes with all between."""
    stray = measure_body([*ball, [1000.0, 1000.0, 1000.0]], H)
    whole = measure_body(ball, H)
    assert (stray.pieces, stray.euler) == (whole.pieces + 1, whole.euler + 2)
    # a ball of 2.6 steps, of which marching cubes cut off a tenth
    assert stray.volume - whole.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.2)


def test_a_surface_does_not_depend_on_the_blocks(ball, monkeypatch):
    """Cut into small blocks, the raster gives the same vertices and as many faces."""
    vertices, faces = body_surface(ball, H)
    monkeypatch.setattr(body, "SMALL_BLOCK", 2000)
    monkeypatch.setattr(body, "BLOCK", 2000)
    in_blocks, faces_in_blocks = body_surface(ball, H)
    np.testing.assert_array_equal(np.unique(in_blocks, axis=0), np.unique(vertices, axis=0))
    assert len(in_blocks) == len(vertices)
    assert len(faces_in_blocks) == len(faces)


def test_nothing_has_no_body():
    """Without a particle every measure is 0."""
    assert measure_body(np.full((5, 3), np.nan), H) == Body(0.0, 0.0, 0, 0)
    assert measure_body(np.empty((0, 3)), H) == Body(0.0, 0.0, 0, 0)


def test_pieces_touch_within_two_radii():
    """Two balls are one piece when they are closer than 1.74 h."""
    assert measure_body([[0, 0, 0], [1.73 * H, 0, 0]], H).pieces == 1
    assert measure_body([[0, 0, 0], [1.75 * H, 0, 0]], H).pieces == 2


def test_topology_of_the_surface_that_is_shown(lattice_ball):
    """2 for a ball, 4 for two or for one that is hollow, 0 for a torus."""
    whole = lattice_ball(4.0, H)
    assert surface_euler(whole, H) == 2
    assert surface_euler(np.concatenate([whole, whole + np.float32(9)]), H) == 4
    assert surface_euler(whole[np.linalg.norm(whole, axis=1) > 2], H) == 4
    across = np.hypot(np.linalg.norm(whole[:, :2], axis=1) - 2.6, whole[:, 2])
    assert surface_euler(whole[across < 1.3], H) == 0


def test_schedule():
    """Linear in time between the ends, or along the shares of a method that eases."""
    np.testing.assert_allclose(over_schedule([1, 2, 3]), 1)
    np.testing.assert_allclose(over_schedule([1, 2.8, 3], [0, 0.9, 1]), 1)


def test_a_body_that_grows_is_measured_by_the_spacing_it_has_by_then(ball):
    """Its volume is as scheduled, and particles are as far apart as ever."""
    shares = np.linspace(0, 1, 5) ** 2
    growth = np.cbrt(1 - shares + 3 * shares)
    m = path_metrics([ball * g for g in growth], H * growth, shares=shares)
    assert [m["volume_min"], m["volume_max"]] == pytest.approx([1, 1], abs=0.01)
    assert m["gap_min"] == pytest.approx(gap_metrics(ball, H)["gap_min"])
    assert (m["more_pieces"], m["more_euler"]) == (0, 0)


def test_motion_does_not_depend_on_timing():
    """Straight lines at a common, uneven pace are the best; detours and turns taken cost."""
    way = np.array([[1, 0, 0], [0, 2, 0]], float)
    eased = motion_metrics([share * way for share in (0, 0.1, 0.1, 0.7, 1)])
    assert eased == pytest.approx({"detour": 1, "action": 1})
    assert motion_metrics([way, way]) == {"detour": 1, "action": 1}
    one_after_the_other = [np.zeros((2, 3)), np.diag([1.0, 0, 0])[:2], np.eye(3)[:2]]
    assert motion_metrics(one_after_the_other) == pytest.approx({"detour": 1, "action": 2})
    angle = np.linspace(0, np.pi, 200)
    arc = [np.array([[np.cos(a), np.sin(a), 0]]) for a in angle]
    # chords of 200 steps: 1 - (pi / 200)^2 / 24
    assert motion_metrics(arc)["detour"] == pytest.approx(np.pi / 2, rel=1e-4)
    assert motion_metrics(arc)["action"] == pytest.approx(np.pi**2 / 4, rel=1e-4)
    assert settled_share(arc, [0.1 * np.pi]) == pytest.approx(0.1, rel=1e-4)


def test_shortest_paths_stay_inside():
    """A bar that is bent to a ring keeps its paths, though not its distances."""
    along, across = np.meshgrid(np.arange(0, LENGTH, H), np.arange(-0.75, 1, H), indexing="ij")
    y = np.repeat(across.reshape(-1), 4)
    x, z = np.repeat(along.reshape(-1), 4), np.tile(np.arange(-0.75, 1, H), along.size)
    bar = np.stack([x, y, z], axis=1)
    radius, angle = LENGTH / 5.5 + y, x * 5.5 / LENGTH
    bent = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    # paths cut the bend by half the thickness of the body at most
    assert geodesic_distortion(bar, bent, H) < (0.75 + RADIUS) / (LENGTH / 5.5)
    straight = [scipy.spatial.distance.pdist(points[::7]) for points in (bar, bent)]
    assert np.sqrt(np.mean((straight[1] - straight[0]) ** 2)) > 0.4 * straight[0].mean()
    assert geodesic_distortion(bar, bar @ TURN + 3, H) < 0.02


def test_parts_go_to_like_parts():
    """The share of each part's matter that arrives in the part of the same label."""
    last = np.array([[-1, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [9, 0, 0]], float)
    where = nearest_labels(np.array([[-1.0, 0, 0], [1, 0, 0]]), [0, 1])
    assert part_transfer([0, 0, 1, 1, -1], last, where) == {0: 0.5, 1: 1.0}


@pytest.fixture(scope="module")
def cube():
    """A cube of edge 4."""
    shape = trimesh.creation.box(extents=[4, 4, 4])
    return make_mesh(shape.vertices, shape.faces, name="cube")


def test_an_even_fill_of_a_mesh(cube):
    """A lattice fills its cube to the floor, and another draw of the reference agrees."""
    axis = np.arange(-1.875, 2, 0.25)
    fill = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    m, again = (mesh_metrics(fill, cube, 0.25, seed=seed) for seed in (0, 1))
    # the square of a distance has a spread of .5 of its mean, over 100 000 points
    assert m["dense_t2s"] == pytest.approx(0.125, rel=0.005)
    assert m["dense_floor"] == pytest.approx(0.125, rel=0.005)
    # border points have fewer others around them than the particles, which keep half a spacing off
    assert m["dense_s2t"] == pytest.approx(m["dense_s2t_floor"], rel=0.05)
    # Gamma(5/3)^(1/2) (3 / 4 pi)^(1/3) of the spacing of 100 000 in a volume of 64
    assert m["dense_s2t_floor"] == pytest.approx(0.5894 * (64 / 100_000) ** (1 / 3), rel=0.05)
    assert m["covered"] == 1
    assert m["mesh_iou"] < m["mesh_iou_level"] < 1
    assert m["mesh_iou_level"] > 0.95
    assert 0.9 < m["density_p05"] < 1 < m["density_p95"] < 1.1
    assert again == pytest.approx(m, rel=0.02)


def test_a_fill_that_misses_half_a_mesh(cube):
    """Half a cube at twice the density: half covered, an overlap of a half, densities 0 and 2."""
    axis = np.arange(-1.9, 2, 0.2)
    half = np.stack(np.meshgrid(axis[axis > 0], axis, axis), axis=-1).reshape(-1, 3)
    m = mesh_metrics(half, cube, 0.2)
    assert m["covered"] == pytest.approx(0.52, abs=0.01)  # the balls reach .07 further
    assert m["mesh_iou"] < 0.52
    # half the cube grown by t has the cube's volume, 32 + 64 t + 10 pi t^2 + 4/3 pi t^3 = 64, at
    # t = .411, and 32 + 16 t of it in the cube; corners of a body of balls are rounded by .1
    assert m["mesh_iou_level"] == pytest.approx(38.6 / (128 - 38.6), abs=0.02)
    assert m["density_p05"] == 0
    assert m["density_p95"] == pytest.approx(2, abs=0.1)


def test_a_fill_that_lies_beside_a_mesh(cube):
    """Particles beside it are as far as its face, and their body counts, however far it is."""
    axis = np.arange(-1.9, 2, 0.2)
    fill = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    beside = mesh_metrics(fill + np.array([6.0, 0, 0]), cube, 0.2)
    # each layer is x + 4 away from the cube's face, on which random points do not quite lie
    assert beside["dense_s2t"] == pytest.approx(np.sqrt(np.mean((axis + 4) ** 2)), abs=0.01)
    assert beside["covered"] == beside["mesh_iou"] == beside["mesh_iou_level"] == 0
    half_off = mesh_metrics(fill + np.array([2.0, 0, 0]), cube, 0.2)
    assert half_off["mesh_iou_level"] == pytest.approx(1 / 3, abs=0.02)


@pytest.fixture(scope="module")
def reference():
    """Points of a ball of radius 6."""
    shape = trimesh.creation.icosphere(subdivisions=4, radius=6.0)
    return Reference(make_mesh(shape.vertices, shape.faces, name="ball"), count=20_000)


def test_a_small_body_is_grown_as_far_as_it_takes(lattice_ball, reference):
    """To the mesh's volume, however far that is beyond its balls and the mesh's box."""
    small = lattice_ball(2.0, H)
    # over 20 000 points a share has an error of .0035
    assert reference.measure(small, H)["mesh_iou_level"] == pytest.approx(1, abs=0.03)
    off = reference.measure(small + np.float32([3, 0, 0]), H)
    # two balls of radius 6 whose centres are 3 apart have 1 - 3/8 + 1/128 in common
    assert off["mesh_iou_level"] == pytest.approx(0.633 / (2 - 0.633), abs=0.02)


def test_a_stray_particle_does_not_change_the_overlap(lattice_ball, reference):
    """It is a ball in 2 000, and what lies between costs neither memory nor points."""
    fill = lattice_ball(6.0, H).astype(np.float64)
    for far in (100.0, 3000.0, 1e9):
        stray = reference.measure([*fill, [far, far, far]], H)
        for name, value in reference.measure(fill, H).items():
            if name != "dense_s2t":
                # other points are drawn around the body; a share has an error of .0035
                assert stray[name] == pytest.approx(value, abs=0.01), name


def test_a_fill_that_is_nowhere_near(reference, lattice_ball):
    """A body outside the usual domain, or of no particle at all, overlaps with nothing."""
    away = reference.measure(lattice_ball(6.0, H) + np.float32([40, 0, 0]), H)
    assert away["covered"] == away["mesh_iou"] == away["mesh_iou_level"] == 0
    assert 30 < away["dense_t2s"] < 40
    lost = reference.measure(np.full((5, 3), np.nan), H)
    assert lost.keys() == away.keys()
    assert lost.pop("dense_s2t_floor") == reference.floor
    for name, value in lost.items():
        assert value == METRICS[name].worst, name


def test_a_grown_surface_is_off_by_the_growth():
    """A sphere grown by .5 is .5 away, and its normals are those of the sphere."""
    sphere = resolve_shape("sphere")
    radius = np.linalg.norm(sphere.vertices - sphere.vertices.mean(axis=0), axis=1).mean()
    m = surface_metrics(Surface(sphere.vertices * (1 + 0.5 / radius), sphere.faces), sphere)
    assert m["surface_mean"] == pytest.approx(0.5, abs=0.02)  # facets are not round
    assert m["surface_p95"] == pytest.approx(0.5, abs=0.02)
    assert m["normal_mean"] < 3


def test_the_path_of_a_result(small_result, tmp_path):
    """A ball that is stretched to an egg moves straight, and as one."""
    m = measure_path(small_result)
    assert m.keys() <= METRICS.keys()
    assert m["d2_min"] == pytest.approx(0, abs=1e-9)  # float32 positions
    assert m["detour"] == pytest.approx(1, abs=1e-6)
    assert m["more_pieces"] == 0
    (tmp_path / "no.vtkhdf").write_bytes(b"x")
    with pytest.raises(ResultError):
        measure_path(tmp_path / "no.vtkhdf")
