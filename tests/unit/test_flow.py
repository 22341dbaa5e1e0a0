"""The body, the pressure that matter flows by, like parts, and the method made of them."""

import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morph_engine import Frame, backend, morph
from morph_engine.errors import ConfigError
from morph_engine.flow import (
    BodyPath,
    LayerArrays,
    Levels,
    NearestGap,
    Projection,
    Registration,
    Settling,
    StrayPieces,
    Warp,
    extend,
    fine_axis,
    multigrid,
    prepare,
    register,
    sample_controls,
)
from morph_engine.flow.body import refined, smoothed
from morph_engine.flow.carrier import CELL, Carrier
from morph_engine.flow.cell_list import CellList
from morph_engine.flow.limbs import in_turn
from morph_engine.flow.settling import FILLING, LONGEST_MOVE, REACH, RELAXATION, UNEVEN
from morph_engine.geometry.mesh import Mesh, make_mesh
from morph_engine.geometry.sampling import sample_lattice
from morph_engine.geometry.shapes import make
from morph_engine.geometry.signed_distance import cloud_distance, mesh_distance
from morph_engine.metrics.body import count_pieces
from morph_engine.morphing import prepare as prepare_run
from morph_engine.mpm import Grid
from morph_engine.presets import configure

GRID = Grid(dx=1.0, half_extent=8.0, width=3)
SMALL = {"method": "flow", "sampling.points_per_cell_edge": 2, "frames": 4}


def ball_distance(centre: tuple[float, float, float], radius: float) -> np.ndarray:
    """Signed distance to a ball on the fine lattice of the grid."""
    axis = fine_axis(GRID)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return (np.linalg.norm(points - centre, axis=-1) - radius).astype(np.float32)


def limbed(spacing: float) -> np.ndarray:
    """Points that fill a body with three limbs of different length, which has no symmetry."""
    axis = np.arange(-6, 6, spacing)
    p = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    limbs = [((0, 1, 2), 6.0), ((1, 2, 0), 4.0), ((2, 0, 1), 2.5)]
    inside = np.zeros(len(p), bool)
    for (along, one, other), length in limbs:
        near = (np.abs(p[:, one]) < 1.1) & (np.abs(p[:, other]) < 1.1)
        inside |= near & (p[:, along] > -1.1) & (p[:, along] < length)
    return p[inside]


def test_distance_to_a_mesh_is_exact_near_it_and_close_everywhere() -> None:
    """Of a sphere it is the distance from its centre less the radius, but for the facets."""
    mesh = make("sphere")
    radius = (mesh.volume * 3 / 4 / np.pi) ** (1 / 3)
    centre = mesh.bounds.mean(axis=0)
    axis = np.linspace(-12, 12, 49)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    wanted = np.linalg.norm(points - centre, axis=-1) - radius
    error = np.abs(mesh_distance(mesh, axis, band=1.5) - wanted)
    assert error[np.abs(wanted) < 1].max() < 0.06 * radius
    assert np.abs(error[np.linalg.norm(points - centre, axis=-1) > 2]).max() < 0.1 * radius


def test_distance_to_a_cloud_encloses_its_volume() -> None:
    """A cube of points at a spacing h has the volume of so many cells."""
    axis = np.arange(-3, 3, 0.5) + 0.25
    cube = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = np.linspace(-5, 5, 101)
    filled = np.count_nonzero(cloud_distance(cube, lattice, radius=0.5) < 0) * 0.1**3
    assert filled == pytest.approx(6**3, rel=0.1)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 1.0])
def test_a_body_has_its_share_of_both_volumes_and_all_the_matter(share: float) -> None:
    """Volume is linear in the share; the mass at nodes is everything there is."""
    path = BodyPath(
        ball_distance((-1, 0, 0), 3), ball_distance((2, 0, 0), 4), GRID, reach=4, matter=500
    )
    body = path.at(share)
    first, last = path.volumes
    volume = np.count_nonzero(body.level.values < 0) / 8
    assert first == pytest.approx(4 / 3 * np.pi * 27, rel=0.02)
    assert volume == pytest.approx((1 - share) * first + share * last, rel=0.01)
    assert body.mass.sum() == pytest.approx(500, rel=1e-4)


def test_a_body_has_its_volume_between_ends_that_lie_far_apart() -> None:
    """Between two balls that do not touch there are two of half the size, and both are kept."""
    ends = (ball_distance((-5, 0, 0), 2), ball_distance((5, 0, 0), 2))
    body = BodyPath(*ends, GRID, reach=4, matter=30).at(0.5)
    assert np.count_nonzero(body.level.values < 0) / 8 == pytest.approx(4 / 3 * np.pi * 8, rel=0.1)


def test_the_pressure_moves_matter_to_where_the_body_goes() -> None:
    """A ball that shifts as a whole flows as a whole: by potential flow, a uniform velocity."""
    backend.start("cpu", threads=2)
    shift, dt = 0.1, 0.05
    path = BodyPath(
        ball_distance((0, 0, 0), 4), ball_distance((shift, 0, 0), 4), GRID, reach=4, matter=268
    )
    now, then = (path.at(share).mass.ravel() for share in (0.0, 1.0))
    device = backend.active()
    projection = Projection(GRID, full=1.0, tolerance=1e-5)
    nodes = device.vectors(GRID.node_count, 4)
    values = np.zeros((GRID.node_count, 4), np.float32)
    values[:, 3] = now
    nodes.from_numpy(values)
    masses = device.upload(now), device.upload(then)
    projection.project(nodes, masses, (0.0, 1.0), dt, gain=0.3)
    moved = nodes.to_numpy()[now > 0.99, :3]
    assert moved[:, 0] == pytest.approx(shift / dt, rel=0.15)
    assert np.abs(moved[:, 1:]).max() < 0.1 * shift / dt


@pytest.mark.parametrize("radius", [2.5, 4.0, 6.0])
def test_the_pressure_is_found_in_a_few_iterations(radius: float) -> None:
    """However large the body is, and also where it asks for more mass than there is.

    No flow inside a body changes its mass: the mean pressure, which nothing determines, once took
    eight iterations more.
    """
    backend.start("cpu", threads=2)
    ball = ball_distance((0, 0, 0), radius)
    mass = BodyPath(ball, ball, GRID, reach=4, matter=4 * radius**3).at(0.5).mass.ravel()
    device = backend.active()
    nodes = device.vectors(GRID.node_count, 4)
    values = np.zeros((GRID.node_count, 4), np.float32)
    values[:, 3] = 0.9 * mass
    rng = np.random.default_rng(1)
    values[mass > 0, :3] = rng.normal(size=(np.count_nonzero(mass > 0), 3))
    nodes.from_numpy(values)
    projection = Projection(GRID, full=1.0, tolerance=1e-2)
    masses = [device.upload(mass)] * 2
    assert projection.project(nodes, masses, (0.0, 1.0), 0.05, gain=0.3) < 1e-2
    assert 0 < projection.iterations_made <= 7


def test_what_is_left_of_the_pressure_is_told() -> None:
    """One iteration leaves more than is asked for, many leave less."""
    backend.start("cpu", threads=2)
    ball = ball_distance((0, 0, 0), 5)
    mass = BodyPath(ball, ball, GRID, reach=4, matter=500).at(0.5).mass.ravel()
    device = backend.active()
    values = np.zeros((GRID.node_count, 4), np.float32)
    values[:, 3] = 0.9 * mass
    values[mass > 0, 0] = 1
    left = []
    for iterations in (1, 100):
        nodes = device.vectors(GRID.node_count, 4)
        nodes.from_numpy(values)
        projection = Projection(GRID, full=1.0, tolerance=1e-3, iterations=iterations)
        masses = [device.upload(mass)] * 2
        left.append(projection.project(nodes, masses, (0.0, 1.0), 0.05, gain=0.3))
    assert left[1] < 1e-3 < left[0]


def test_one_thread_or_many_find_the_same_pressure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of a small grid are one thread's; shared out, they are listed in another order."""
    backend.start("cpu", threads=2)
    ball = ball_distance((0, 0, 0), 5)
    mass = BodyPath(ball, ball, GRID, reach=4, matter=500).at(0.5).mass.ravel()
    values = np.zeros((GRID.node_count, 4), np.float32)
    values[:, 3] = 0.9 * mass
    rng = np.random.default_rng(1)
    values[mass > 0, :3] = rng.normal(size=(np.count_nonzero(mass > 0), 3))
    device, found = backend.active(), []
    for smallest in (GRID.resolution + 1, 4):
        monkeypatch.setattr(multigrid, "SMALLEST_SHARED_CPU", smallest)
        nodes = device.vectors(GRID.node_count, 4)
        nodes.from_numpy(values)
        masses = [device.upload(mass)] * 2
        projection = Projection(GRID, full=1.0, tolerance=1e-4)
        projection.project(nodes, masses, (0.0, 1.0), 0.05, gain=0.3)
        found.append((projection.iterations_made, nodes.to_numpy()))
    (alone, velocity), (shared, same) = found
    assert alone == shared
    assert velocity == pytest.approx(same, abs=1e-5)


def test_the_pressure_takes_out_a_flow_through_the_surface() -> None:
    """Matter that rushes along a body that stays where it is is stopped."""
    backend.start("cpu", threads=2)
    ball = ball_distance((0, 0, 0), 4)
    mass = BodyPath(ball, ball, GRID, reach=4, matter=268).at(0.5).mass.ravel()
    device = backend.active()
    nodes = device.vectors(GRID.node_count, 4)
    values = np.zeros((GRID.node_count, 4), np.float32)
    values[:, 3] = mass
    values[mass > 0, 0] = 1.0
    nodes.from_numpy(values)
    masses = [device.upload(mass)] * 2
    Projection(GRID, full=1.0, tolerance=1e-5).project(nodes, masses, (0.0, 1.0), 0.05, gain=0.3)
    assert np.abs(nodes.to_numpy()[mass > 0.99, :3]).max() < 0.15


def solid(path: BodyPath, share: float) -> np.ndarray:
    """Which points of the whole fine lattice of GRID are inside the body."""
    inside = np.zeros((len(fine_axis(GRID)),) * 3, bool)
    level = path.at(share).level
    box = zip(level.corner, level.corner + level.values.shape, strict=True)
    inside[tuple(slice(low, high) for low, high in box)] = level.values < 0
    return inside


def wide_body() -> Levels:
    """Levels of a body whose surface is 5 dx away from everywhere."""
    device, size = backend.active(), len(fine_axis(GRID))
    deep, box = device.upload(np.full(size**3, -5.0)), device.integers(6)
    box.from_numpy(np.array([0, 0, 0, size, size, size], np.int32))
    return Levels(now=deep, then=deep, box=box)


def settled(x: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
    """Particles of spacing 0.5 after one round of settling in a wide body, and what they moved."""
    backend.start("cpu", threads=2)
    device = backend.active()
    positions, moved = device.upload(np.float32(x)), device.scalars(len(x))
    settling = Settling(len(x), GRID, spacing=0.5)
    settling.settle(positions, moved, (wide_body(), 0.0), distance=0.4, spacing=0.5, most=most)
    return positions.to_numpy(), moved.to_numpy()


def make_ball(spacing: float, radius: float) -> np.ndarray:
    """Lattice points of a ball."""
    axis = np.arange(-radius, radius + spacing / 2, spacing)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return points[np.linalg.norm(points, axis=1) < radius]


def cubic_lattice(spacing: float) -> np.ndarray:
    """Points of a cube."""
    axis = np.arange(-3, 3.01, spacing)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def gathered(x: np.ndarray, ends: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Particles of spacing 0.25 once stray pieces were gathered, and what they moved."""
    backend.start("cpu", threads=2)
    device = backend.active()
    positions, moved = device.upload(np.float32(x)), device.scalars(len(x))
    cells = CellList(len(x), GRID, 0.25)
    StrayPieces(ends, 0.25, cells).gather(positions, moved, 0.25)
    return positions.to_numpy(), moved.to_numpy()


def test_a_few_particles_that_came_off_go_back_to_the_body() -> None:
    """Two crumbs side by side join the body, not each other; each keeps its form."""
    ball = make_ball(0.25, 3.5)
    single = np.array([[0, 0, 4.6], [0, 4.5, 0.1], [0, 4.5, 0.35]])
    x = np.concatenate([ball, single])
    after, moved = gathered(x, [ball, ball])
    assert count_pieces(x, 0.25) == 3
    assert count_pieces(after, 0.25) == 1
    assert (after[: len(ball)] == np.float32(ball)).all()
    assert after[-1] - after[-2] == pytest.approx(x[-1] - x[-2], abs=1e-6)
    assert moved == pytest.approx(np.linalg.norm(after - x, axis=1), abs=1e-6)


def test_crumbs_that_go_back_to_one_place_keep_apart() -> None:
    """Both are above the same particle of the body; neither comes to lie on the other."""
    ball = make_ball(0.25, 3.5)
    x = np.concatenate([ball, [[0, 0, 4.6], [0, 0, 5.3]]])
    after, _ = gathered(x, [ball, ball])
    assert count_pieces(after, 0.25) == 1
    assert cKDTree(after).query(after[-2:], k=2)[0][:, 1].min() > 0.25


def test_pieces_that_the_ends_have_stay_apart() -> None:
    """Where source or target is in pieces as small, none is taken for stray."""
    ball = make_ball(0.25, 3.5)
    x = np.concatenate([ball, [[0, 0, 4.6]]])
    after, moved = gathered(x, [ball, x])
    assert (after == np.float32(x)).all()
    assert not moved.any()


def test_the_nearest_other_particle() -> None:
    """As a tree finds it, up to the bound; two particles at one place are at no distance."""
    backend.start("cpu", threads=2)
    x = np.float32(np.random.default_rng(3).uniform(-2, 2, (800, 3)))
    x[1] = x[0]
    x[2] = [5, 5, 5]
    cells = CellList(len(x), GRID, 0.5)
    gap = NearestGap(cells).find(backend.active().upload(x), 0.5).to_numpy()
    distance = cKDTree(x).query(x, k=2)[0][:, 1]
    assert gap == pytest.approx(np.where(distance < 0.5, distance, np.inf), abs=1e-6)
    assert gap[0] == gap[1] == 0
    assert np.isinf(gap[2])


def test_particles_too_close_move_apart_evenly() -> None:
    """Each of a pair makes room by as much, along the line between them; who is alone stays."""
    x = np.array([[0, 0, 0], [0.2, 0, 0], [3, 3, 3]])
    after, moved = settled(x, most=1.0)
    assert after[1, 0] - after[0, 0] > 0.3
    assert after[0] + after[1] == pytest.approx(x[0] + x[1], abs=1e-6)
    assert (after[2] == x[2]).all()
    assert moved == pytest.approx(np.linalg.norm(after - x, axis=1), abs=1e-6)


def test_particles_fill_a_gap_and_an_even_fill_stays() -> None:
    """Those beside a missing plane move into it; those deep in the lattice do not move."""
    x = cubic_lattice(0.5)
    x = x[np.abs(x[:, 0]) > 0.1]
    after, moved = settled(x, most=1.0)
    inner = (np.abs(x[:, 1:]) < 1.6).all(axis=1)
    beside = inner & (np.abs(x[:, 0]) < 0.6)
    assert (np.abs(after[beside, 0]) < np.abs(x[beside, 0]) - 0.02).all()
    assert moved[inner & (np.abs(np.abs(x[:, 0]) - 1.5) < 0.1)].max() == 0


@pytest.mark.parametrize("count", [1, 7, 8, 9, 500])
def test_every_neighbour_counts_once(count: int) -> None:
    """The move is the sum over all pairs, however many particles there are."""
    h, reach = 0.5, REACH * 0.5
    x = np.float32(np.random.default_rng(count).uniform(-1.5, 1.5, (count, 3)))
    away = (x[:, None] - x[None]).astype(float)
    length = np.linalg.norm(away, axis=2) + np.eye(count)
    w = (np.maximum(1 - length / reach, 0) ** 2 / length)[..., None]
    uneven = (w * away).sum(axis=1)
    beyond = np.maximum(1 - UNEVEN / np.maximum(np.linalg.norm(uneven, axis=1), 1e-12), 0)
    overlap = (np.maximum(0.4 - length, 0) / length)[..., None]
    move = RELAXATION * (overlap * away).sum(axis=1) + FILLING * h * beyond[:, None] * uneven
    size = np.linalg.norm(move, axis=1, keepdims=True)
    move *= np.minimum(1, LONGEST_MOVE * h / np.maximum(size, 1e-12))
    after, _ = settled(x, most=1.0)
    assert after == pytest.approx(x + move, abs=1e-5)


def test_who_needs_it_most_moves_where_not_all_may() -> None:
    """The mean of the moves is what it may be, and it is made of the longest ones."""
    x = cubic_lattice(0.5)
    x = x[np.abs(x[:, 0]) > 0.1]
    x[0] = x[1] + 0.1
    _, free = settled(x, most=1.0)
    _, moved = settled(x, most=0.1 * float(free.mean()))
    assert moved.mean() == pytest.approx(0.1 * free.mean(), rel=1e-3)
    assert free[moved > 0].min() > free[moved == 0].max()


def test_a_limb_goes_from_its_tip_and_none_of_it_is_cut_off() -> None:
    """A rod that a ball takes in gets shorter and keeps half its section, all in one piece."""
    axis = fine_axis(GRID)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    ball = np.sqrt(x**2 + y**2 + z**2) - 3
    rod = np.maximum(np.sqrt(y**2 + z**2) - 0.9, np.abs(x - 3.5) - 3.5)
    source = np.minimum(ball, rod).astype(np.float32)
    path = BodyPath(source, ball.astype(np.float32), GRID, reach=4, matter=130, tension=1.0)
    bodies = [solid(path, share) for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    assert all(scipy.ndimage.label(body)[1] == 1 for body in bodies)
    lengths = [x[body].max() for body in bodies]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[2] > 5
    sections = [np.count_nonzero(body & (x == 4)) for body in bodies]
    assert sections[2] > 0.45 * sections[0]


def test_points_follow_their_neighbours() -> None:
    """T_x = max(t_x, min over neighbours of T + delay) outside the core; what is apart has none."""
    random = np.random.default_rng(5)
    turn = random.random((9, 12, 7), np.float32)
    inside = random.random(turn.shape) < 0.6
    core = np.zeros(turn.shape, bool)
    core[2:4, 5:8, 3] = inside[2:4, 5:8, 3]
    delay = 0.0625
    later = in_turn(turn, inside, core, delay)
    around = np.pad(later, 1, constant_values=np.inf)
    neighbours = [
        np.roll(around, step, axis)[1:-1, 1:-1, 1:-1] for axis in range(3) for step in (-1, 1)
    ]
    follow = np.maximum(turn, np.min(neighbours, axis=0) + np.float32(delay))
    np.testing.assert_array_equal(later[core], turn[core])
    np.testing.assert_array_equal(later[inside & ~core], follow[inside & ~core])
    assert np.isinf(later[~inside]).all()
    pieces, _ = scipy.ndimage.label(inside)
    reached = np.isin(pieces, pieces[core])
    assert np.isfinite(later[inside & reached]).all()
    assert np.isinf(later[inside & ~reached]).all()


@pytest.mark.parametrize("growing", [False, True])
def test_a_thick_end_is_not_left_by_the_thin_part_that_joins_it(growing: bool) -> None:
    """A ball on a rod comes and goes with it: the body is in one piece all the way."""
    axis = fine_axis(GRID)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    ball, end = ball_distance((-3, 0, 0), 3), ball_distance((4, 0, 0), 1.9)
    rod = np.maximum(np.sqrt(y**2 + z**2) - 0.8, np.abs(x - 1) - 3)
    joined = np.minimum(np.minimum(ball, end), rod).astype(np.float32)
    source, target = (ball, joined) if growing else (joined, ball)
    path = BodyPath(source, target, GRID, reach=4, matter=130, tension=1.0)
    bodies = [solid(path, share) for share in np.linspace(0, 1, 41)]
    assert [scipy.ndimage.label(body)[1] for body in bodies] == [1] * len(bodies)
    assert sum(bool(body[x > 3].any()) for body in bodies) > 10


def test_what_is_cut_off_all_the_same_is_given_up() -> None:
    """The end of the teapot's spout on its way to a heart; a piece that an end has stays."""
    grid = Grid(0.5, 14.0)
    axis = fine_axis(grid)
    teapot, heart = (mesh_distance(make(name), axis, 1.0) for name in ("teapot", "heart"))
    path = BodyPath(teapot, heart, grid, reach=4, matter=35_000, tension=1.0)
    for share in (0.3, 0.4):
        assert scipy.ndimage.label(path.at(share).level.values < 0)[1] == 1
    ball, other = ball_distance((-3, 0, 0), 2.5), ball_distance((4, 0, 0), 2)
    path = BodyPath(np.minimum(ball, other), ball, GRID, reach=4, matter=65, tension=1.0)
    assert scipy.ndimage.label(path.at(0.2).level.values < 0)[1] == 2


def test_many_pieces_become_one() -> None:
    """As letters do: there are ever fewer, and no more than the ends have, both ways."""
    grid = Grid(1.0, 12.0)
    x, y, z = np.meshgrid(*[fine_axis(grid)] * 3, indexing="ij")
    radii = [np.sqrt((x - place) ** 2 + y**2 + z**2) for place in (-8, -4, 0, 4, 8)]
    five, ball = np.min(radii, axis=0) - 1.8, radii[2] - 4
    for ends in ((five, ball), (ball, five)):
        path = BodyPath(*(e.astype(np.float32) for e in ends), grid, reach=4, matter=130)
        levels = [path.at(share).level.values for share in np.linspace(0, 1, 11)]
        counts = [scipy.ndimage.label(level < 0)[1] for level in levels]
        assert {counts[0], counts[-1]} == {1, 5}
        assert set(counts) <= {1, 2, 3, 4, 5}


def test_a_refined_field_is_trilinear_between_its_points() -> None:
    """What SciPy interpolates, to the rounding of float32."""
    field = np.random.default_rng(0).random((4, 7, 5), np.float32)
    zoomed = scipy.ndimage.zoom(field, [2 - 1 / n for n in field.shape], order=1)
    np.testing.assert_allclose(refined(field), zoomed, rtol=3e-7)


def test_a_field_is_smoothed_by_splines_and_is_zero_beyond_its_box() -> None:
    """As by convolution along each axis."""
    field = np.random.default_rng(3).random((7, 6, 9), np.float32)
    expected = field.astype(np.float64)
    for axis in range(3):
        expected = scipy.ndimage.convolve1d(
            expected, np.array([1, 4, 6, 4, 1]) / 16, axis=axis, mode="constant"
        )
    np.testing.assert_allclose(smoothed(field), expected, rtol=1e-5)


def test_the_level_leads_back_to_the_body_from_everywhere_near() -> None:
    """No local minimum outside, between two shapes of which one has a far part."""
    ball, other = ball_distance((-3, 0, 0), 2.5), ball_distance((4, 0, 0), 1)
    path = BodyPath(np.minimum(ball, other), ball, GRID, reach=4, matter=65, tension=1.0)
    level = path.at(0.9).level.values
    lowest = scipy.ndimage.minimum_filter(level, size=3)
    assert not ((level == lowest) & (level > 0.1) & (level < 6)).any()


def test_outside_its_box_a_level_is_that_of_the_edge_and_the_distance_to_it() -> None:
    """So it grows away from the body, up to the ends of the larger box."""
    backend.start("cpu", threads=2)
    device = backend.active()
    near = np.random.default_rng(0).random((4, 5, 3), np.float32)
    corner, size, low = np.array([2, 1, 0]), np.array([9, 7, 8]), np.array([3, 1, 4])
    boxes = []
    for box in ((low, near.shape), (corner, size)):
        boxes.append(device.integers(6))
        boxes[-1].from_numpy(np.concatenate(box).astype(np.int32))
    level = device.scalars(int(size.prod()))
    extend(device.upload(near.ravel()), boxes[0], level, boxes[1], 0.5)
    points = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1) + corner - low
    edge = points.clip(0, np.array(near.shape) - 1)
    wanted = near[tuple(edge.T)].T + 0.5 * np.linalg.norm(points - edge, axis=-1)
    assert level.to_numpy().reshape(size) == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize("kept", [0.0, 0.5, 1.0])
def test_strain_yields_and_changes_of_volume_are_kept_apart(kept: float) -> None:
    """b = F F^T, without its change of volume, goes towards the identity; det F is handed over."""
    backend.start("cpu", threads=2)
    device = backend.active()
    F = np.float32([[1.5, 0.2, 0], [0, 0.9, 0.1], [0.1, 0, 1.1]])
    layer = {"x": device.vectors(1), "v": device.vectors(1)}
    layer |= {"C": device.matrices(1), "F": device.matrices(1)}
    layer["F"].from_numpy(F[None])
    ratio = device.upload(np.ones(1))
    still, share, depth, firmness, momentum, dt = device.vectors(1), 0.0, 0.1, 1.0, 0.0, 0.01
    prepare(
        LayerArrays(**layer), ratio, still, wide_body(), share, depth, firmness, momentum, kept,
        dt, GRID,
    )  # fmt: skip
    J = np.linalg.det(F)
    wanted = kept * J ** (-2 / 3) * F @ F.T + (1 - kept) * np.eye(3)
    wanted /= np.linalg.det(wanted) ** (1 / 3)
    after = layer["F"].to_numpy()[0]
    assert after @ after.T == pytest.approx(wanted, abs=1e-5)
    assert ratio.to_numpy() == pytest.approx([J], rel=1e-5)


@pytest.fixture(scope="module")
def turned() -> tuple[np.ndarray, Rotation, Warp, Registration]:
    """A body, a turn, the warp found from the body to its turned image, and its registration."""
    source, turn = limbed(0.5), Rotation.from_euler("zx", [80, 30], degrees=True)
    target = turn.apply(limbed(0.45))
    controls = sample_controls(source, 0.5)
    found = register(controls, sample_controls(target, 0.45), 1.0)
    return source, turn, Warp(controls, found), found


def test_a_turned_body_is_found_and_turns_rigidly(turned) -> None:
    """Every point ends near its own place, and distances hold on the way."""
    source, turn, warp, found = turned
    assert found.mismatch < 0.8
    end = warp.forward(warp.follow(source), 1.0)
    assert np.sqrt(np.mean(np.sum((end - turn.apply(source)) ** 2, axis=1))) < 0.5
    half = warp.forward(warp.follow(source), 0.5)
    pairs = cKDTree(source).query_pairs(3.0, output_type="ndarray")[::50]
    before, after = (
        np.linalg.norm(p[pairs[:, 0]] - p[pairs[:, 1]], axis=1) for p in (source, half)
    )
    assert np.sqrt(np.mean((after - before) ** 2)) < 0.15
    assert np.abs(after - before).max() < 0.5


def ball(radius: float, spacing: float) -> np.ndarray:
    """Points that fill a ball about the origin."""
    axis = np.arange(-radius, radius + spacing / 2, spacing)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    inside: np.ndarray = points[np.linalg.norm(points, axis=1) <= radius]
    return inside


@pytest.mark.parametrize("degrees", [0, 100])
def test_pieces_that_do_not_touch_keep_their_distances_as_the_whole_turns(degrees: float) -> None:
    """Three balls stay as they are, or turn about the middle of all; none drifts."""
    places = np.array([[-4.0, 0, 0], [4.0, 0, 0], [0, 5.0, 1.0]])
    source = np.concatenate([place + ball(2.0, 0.5) for place in places])
    turn = Rotation.from_euler("z", degrees, degrees=True)
    controls = sample_controls(source, 0.5)
    if degrees:
        found = Registration(turn.apply(controls.points), 0.0, 0.0)
    else:
        found = register(controls, controls, 1.0)
    warp, middle = Warp(controls, found), source.mean(axis=0)
    for share in (0.1, 0.5, 1.0):
        part = Rotation.from_euler("z", share * degrees, degrees=True)
        moved = (1 - share) * middle + share * turn.apply(middle)
        expected = part.apply(source - middle) + moved
        there = warp.forward(warp.follow(source), share)
        assert np.linalg.norm(there - expected, axis=1).max() < 0.35


def test_a_warp_knows_where_points_come_from_and_go(turned) -> None:
    """`ends` undoes and completes `forward`."""
    source, _, warp, _ = turned
    begin, end = warp.ends(warp.forward(warp.follow(source), 0.4), 0.4)
    assert np.abs(begin - source).mean() < 0.05
    assert np.abs(end - warp.forward(warp.follow(source), 1.0)).mean() < 0.1


def test_distances_are_carried_exactly_near_the_surface(turned) -> None:
    """Where it matters they are blended point by point; farther out nothing gets near to it."""
    source, turn, warp, _ = turned
    axis, share = fine_axis(GRID), 0.4
    ends = [cloud_distance(body, axis, 0.5) for body in (source, turn.apply(source))]
    carrier = Carrier(warp, ends, GRID)
    places = carrier.places(share)
    blend = carrier.blended(share, places)
    level = blend.values
    points = np.stack(np.meshgrid(*map(np.arange, level.shape), indexing="ij")) + (
        blend.corner.reshape(3, 1, 1, 1)
    )
    along = points / CELL - np.reshape(places.corner, (3, 1, 1, 1))
    blended = 0
    for weight, at, end in ((1 - share, places.back, ends[0]), (share, places.onward, ends[1])):
        place = [
            scipy.ndimage.map_coordinates(one.reshape(places.size), along, order=1, mode="nearest")
            for one in at.T
        ]
        there = scipy.ndimage.map_coordinates(end, np.stack(place), order=1, mode="nearest")
        blended += weight * there
    inside = (along >= 0).all(axis=0) & (along.T < np.array(places.size) - 1).all(axis=-1).T
    near = inside & (np.abs(blended) < 1)
    assert near.sum() > 1000
    assert level[near] == pytest.approx(blended[near], abs=1e-4)
    np.testing.assert_array_equal(level[inside] < 0, blended[inside] < 0)
    assert np.abs(level[~near]).min() > 0.9


def test_a_warp_meets_landmarks_and_takes_what_is_around_them_along() -> None:
    """The long limb of a body goes to the short one of its twin, against all likeness."""
    body = limbed(0.5)
    tips = np.array([[5.5, 0.0, 0.0], [0.0, 3.5, 0.0]])
    controls = sample_controls(body, 0.5, tips)
    warp = Warp(controls, register(controls, sample_controls(body, 0.5, tips[::-1]), 1.0))
    assert warp.forward(warp.follow(tips), 1.0) == pytest.approx(tips[::-1], abs=0.1)
    long_limb = body[body[:, 0] > 2.5]
    ended = warp.forward(warp.follow(long_limb), 1.0)
    assert np.mean(ended[:, 1] > ended[:, 0]) > 0.9


@pytest.mark.parametrize("sides", [(24, 24, 1), (24, 1, 1), (5, 4, 4)])
def test_flat_thin_and_small_shapes_are_carried(sides: tuple[int, int, int]) -> None:
    """To a ball and back; points end where there is matter."""
    axes = [0.5 * np.arange(count) for count in sides]
    shape = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    axis = np.arange(-3, 3.1, 0.5)
    ball = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = ball[np.linalg.norm(ball, axis=1) <= 3]
    for source, target in ((shape, ball), (ball, shape)):
        controls = sample_controls(source, 0.5)
        growth = (len(target) / len(source)) ** (1 / 3)
        warp = Warp(controls, register(controls, sample_controls(target, 0.5), growth))
        end = warp.forward(warp.follow(source), 1.0)
        assert np.abs(end.mean(axis=0) - target.mean(axis=0)).max() < 1


def test_a_landmark_is_met_at_the_end() -> None:
    """Matter at it ends where it belongs, which is not where it goes by itself."""
    settings = SMALL | {"frames": 10}
    run = prepare_run("sphere", "heart", configure(overrides=settings))
    marked = int(run.source_points[:, 1].argmax())
    place = run.target_points[run.target_points[:, 0].argmax()]
    pair = {"source": run.source_points[marked].tolist(), "target": place.tolist()}

    def miss(landmarks: list[dict[str, list[float]]]) -> float:
        config = configure(overrides=settings | {"landmarks": landmarks})
        last = list(morph("sphere", "heart", config))[-1].positions
        return float(np.linalg.norm(last[marked] - place))

    assert miss([]) > 3
    assert miss([pair]) < 1


def test_a_landmark_at_a_sharp_tip_of_a_mesh_is_met() -> None:
    """Vertices where no particle fits are landmarks, of source and target; the nearest one goes."""
    tip = trimesh.creation.cone(3.0, 24.0, sections=32)
    thorn = make_mesh(tip.vertices, tip.faces, name="thorn")
    ends = {"source": [0.0, 0.0, 24.0], "target": [0.0, 0.0, 24.0]}
    turned = {"placement.target.rotate": (90.0, 0.0, 0.0), "frames": 10}
    config = configure(overrides=SMALL | turned | {"landmarks": [ends]})
    run = prepare_run(thorn, thorn, config)
    source, target = (
        cKDTree(points).query(similarity.apply(np.array([[0.0, 0.0, 24.0]])))
        for points, similarity in (
            (run.source_points, run.placement.source), (run.target_points, run.placement.target),
        )
    )  # fmt: skip
    assert source[0] > 1
    last = list(morph(thorn, thorn, config))[-1].positions
    assert np.linalg.norm(last[source[1]] - run.target_points[target[1]]) < 1


def test_the_extent_of_a_shape_is_that_of_its_mesh() -> None:
    """And not that of its particles, which end before its corners."""
    tip = trimesh.creation.cone(5.0, 14.0, sections=32)
    thorn = make_mesh(tip.vertices, tip.faces, name="thorn")
    pair = {"source": (0.0, 0.0, 16.0), "target": (0.0, 0.0, 0.0)}
    config = configure(overrides=SMALL | {"landmarks": [pair]})
    with pytest.raises(ConfigError, match=r"lies 2\.[0-9] .*\(-5, -5, 0\) to \(5, 5, 14\)"):
        next(iter(morph(thorn, "sphere", config)))


def test_a_landmark_may_have_a_name() -> None:
    """Which is kept with the settings."""
    pair = {"source": [0, 0, 1], "target": [1, 0, 0], "name": "front"}
    config = configure(overrides=SMALL | {"landmarks": [pair]})
    assert config.model_dump(mode="json")["method"]["landmarks"] == [pair]


def test_a_landmark_off_the_shape_is_refused(tmp_path: Path) -> None:
    """The message says how far off, and where the shape is; nothing is left to be continued."""
    pair = {"source": (0.0, 20.0, 0.0), "target": (0.0, 0.0, 0.0)}
    config = configure(overrides=SMALL | {"landmarks": [pair]})
    out = tmp_path / "result.vtkhdf"
    with pytest.raises(ConfigError, match=r"landmark 0, 20, 0 lies .* outside the shape") as caught:
        next(iter(morph("sphere", "heart", config, out=out)))
    assert "coordinates of the mesh" in caught.value.remedy
    assert not [*tmp_path.iterdir()]


def test_where_a_turned_shape_is_is_told_in_its_own_coordinates() -> None:
    """From its least coordinates to the largest, though the axes of the grid are others."""
    pair = {"source": (0.0, 0.0, 0.0), "target": (0.0, 0.0, 30.0)}
    turned = {"placement.target.rotate": (180.0, 0.0, 0.0)}
    config = configure(overrides=SMALL | turned | {"landmarks": [pair]})
    with pytest.raises(ConfigError, match="outside the shape") as caught:
        next(iter(morph("sphere", "heart", config)))
    found = re.findall(r"\(([^)]*)\)", caught.value.cause)
    lowest, highest = ([float(x) for x in corner.split(", ")] for corner in found)
    assert (np.array(lowest) < highest).all()


def test_matter_fills_the_target_and_stays_one_body() -> None:
    """Particles end inside the target, evenly, and no more are moved by settling than may be."""
    config = configure(overrides=SMALL | {"frames": 16})
    frames = list(morph("sphere", "star", config, threads=2))
    last = frames[-1]
    assert last.metrics["cover"] > 0.94
    assert last.metrics["outside_share"] < 0.01
    assert last.metrics["rho_p05"] > 0.8
    positions = [
        prepare_run("sphere", "star", config).source_points,
        *(f.positions for f in frames),
    ]
    path = sum(np.linalg.norm(b - a, axis=1).mean() for a, b in pairwise(positions))
    assert sum(frame.metrics["correction"] for frame in frames) < 0.0201 * path
    nearest = cKDTree(frames[8].positions).query(frames[8].positions, 2)[0][:, 1]
    assert nearest.max() < 2 * config.spacing  # nobody is left behind


def test_elasticity_decides_the_path() -> None:
    """Stiff and soft matter take other paths to the same body."""
    paths = [
        list(morph("heart", "star", configure(overrides=SMALL | {"material.youngs_modulus": e})))
        for e in (1.0, 140_000.0)
    ]
    apart = np.linalg.norm(paths[0][2].positions - paths[1][2].positions, axis=1)
    assert np.sqrt(np.mean(apart**2)) > 0.02
    assert all(frames[-1].metrics["cover"] > 0.9 for frames in paths)


def test_a_resumed_run_and_any_number_of_threads_give_the_same_bits(tmp_path) -> None:
    """A run cut after two frames goes on as if nothing had happened."""
    config = configure(overrides=SMALL)
    whole = [f.positions for f in morph("sphere", "star", config, threads=1)]
    out = tmp_path / "run.vtkhdf"
    for frame in morph("sphere", "star", config, threads=1, out=out):
        if frame.index == 1:
            break
    resumed = [
        f.positions for f in morph("sphere", "star", config, threads=1, out=out, resume=True)
    ]
    for one, other in zip(whole, resumed, strict=True):
        assert np.array_equal(one, other)
    there = tmp_path / "there.npy"
    code = (
        "import numpy as np; from morph_engine import morph; from morph_engine.presets import "
        f"configure; np.save({str(there)!r}, [f.positions for f in morph('sphere', 'star', "
        f"configure(overrides={SMALL!r}), threads=2)])"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert np.array_equal(whole, np.load(there))


def test_clouds_are_morphed_as_meshes_are() -> None:
    """Without a mesh the body is the union of balls around the points."""
    clouds = [
        sample_lattice(make(name), spacing=0.5, jitter="none") for name in ("sphere", "heart")
    ]
    last = list(morph(*clouds, configure(overrides=SMALL)))[-1]
    assert last.metrics["cover"] > 0.95


def as_mesh(*parts: trimesh.Trimesh) -> Mesh:
    """A shape of one or more parts, as it stands."""
    whole = trimesh.util.concatenate(parts)
    return Mesh(np.asarray(whole.vertices), np.asarray(whole.faces, np.int32), "shape", "0" * 64)


def last_frame(source: Mesh, target: Mesh, **settings: Any) -> Frame:
    """The last frame of a morph of shapes as they stand."""
    config = configure("fast", {"sampling.fit": "none"} | settings)
    *_, last = morph(source, target, config, device="cpu", threads=2)
    return last


def test_matter_spreads_to_fifty_times_its_volume() -> None:
    """The farthest point of the ball is no farther from matter than three of its spacings there."""
    rod = trimesh.creation.capsule(radius=0.8, height=12.4)
    rod.apply_translation(-rod.bounds.mean(axis=0))
    ball = trimesh.creation.icosphere(3, radius=7)
    growth = ball.volume / rod.volume
    assert growth > 50
    last = last_frame(as_mesh(rod), as_mesh(ball), frames=16)
    assert last.metrics["t2s_over_h"] < 0.9 * np.cbrt(growth)


def test_a_body_breaks_into_many_small_pieces() -> None:
    """Each is smaller than what is given up elsewhere, and all together are the target."""
    ball = trimesh.creation.icosphere(2, radius=2.45)
    places = product((-6, -3, 0, 3, 6), (-3, 0, 3), (-3, 0, 3))
    pieces = [trimesh.creation.icosphere(2, radius=0.69).apply_translation(at) for at in places]
    last = last_frame(as_mesh(ball), as_mesh(*pieces), frames=12)
    assert last.metrics["coverage"] > 0.6


def test_a_sheet_between_the_points_of_the_lattice_is_a_cloud() -> None:
    """Its mesh has no lattice point inside, and yet it has particles."""
    sheets = [trimesh.creation.box(sides) for sides in ((14, 14, 0.1), (18, 10, 0.1))]
    for sheet in sheets:
        sheet.apply_translation((0, 0, 0.17))
    last = last_frame(*map(as_mesh, sheets), frames=4)
    assert last.metrics["coverage"] > 0.7


def test_a_body_off_the_origin_turns_within_the_grid() -> None:
    """It would leave the grid if it turned about itself; landmarks say that it is to turn."""
    head = trimesh.creation.icosphere(3, radius=3.5).apply_translation((0, 0, -6.5))
    handle = trimesh.creation.cylinder(radius=0.6, height=14).apply_translation((0, 0, 3))
    upright = as_mesh(head, handle)
    flipped = replace(upright, vertices=upright.vertices * (1, -1, -1))
    marks = [((0, 0, 10), (0, 0, -10)), ((3.4, 0, -6.5), (3.4, 0, 6.5))]
    marks.append(((0, 3.4, -6.5), (0, -3.4, 6.5)))
    landmarks = [{"source": source, "target": target} for source, target in marks]
    settings = {"sampling.points_per_cell_edge": 2, "landmarks": landmarks}
    last = last_frame(upright, flipped, frames=30, **settings)
    assert last.metrics["coverage"] > 0.95
    # a body of revolution: only where matter of the handle's end is tells that it has turned
    source = prepare_run(upright, flipped, configure("fast", {"sampling.fit": "none"} | settings))
    end = source.source_points[:, 2] > 8
    assert last.positions[end, 2].max() < -6


def test_the_step_of_other_methods_limits_nothing() -> None:
    """The flow's own steps are as many as it needs, and stiffer matter is made softer."""
    for settings in ({"grid.dx": 0.25}, {"material.youngs_modulus": 1e6}):
        assert configure("fast", settings).method.name == "flow"
        with pytest.raises(ConfigError, match="stability limit"):
            configure("fast", {"method": "joint"} | settings)


def test_waves_ask_for_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matter six times as stiff as usual takes eight steps a frame, and stays whole."""
    made = []
    project = Projection.project

    def counted(*given: Any, **options: float) -> float:
        made.append(given)
        return project(*given, **options)

    monkeypatch.setattr(Projection, "project", counted)
    stiff = configure(overrides=SMALL | {"method.material.youngs_modulus": 9e5, "frames": 12})
    frames = [(len(made), frame) for frame in morph("sphere", "star", stiff)]
    steps = np.diff([0] + [count for count, _ in frames])
    assert steps.min() == 8
    assert not any(event.kind == "restart" for _, frame in frames for event in frame.events)
    assert frames[-1][1].metrics["coverage"] > 0.98
