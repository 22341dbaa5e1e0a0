"""Metrics: hand-computed cases, identities, floors, and the paper's own start values."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morph_engine.errors import MeshError
from morph_engine.metrics.chamfer import chamfer_metrics
from morph_engine.metrics.definitions import METRICS
from morph_engine.metrics.deformation import deformation_metrics
from morph_engine.metrics.volume import fill_metrics

Cloud = npt.NDArray[np.float64]
ORIGIN = np.zeros((1, 3))

# Coordinates on a grid of 1/64: sums and squares are exact, so that a near-tie stays what it is.
clouds = arrays(
    np.float64,
    st.tuples(st.integers(1, 30), st.just(3)),
    elements=st.integers(-512, 512).map(lambda i: i / 64),
)

properties = settings(deadline=None, max_examples=50)  # a busy machine is no failure


def lattice(count: int, spacing: float) -> Cloud:
    """A cube of ``count`` points per edge that starts at the origin, shape [count^3, 3]."""
    axis = np.arange(count) * spacing
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def jittered(count: int, spacing: float, seed: int) -> Cloud:
    """A cube of points like a run's own target: a lattice with 10 % jitter."""
    noise = np.random.default_rng(seed).uniform(-0.1, 0.1, (count**3, 3))
    return lattice(count, spacing) + noise * spacing


# --- hand-computed -----------------------------------------------------------------------------


def test_two_points() -> None:
    """One particle, one target point, 5 apart: every distance is 5, no share is reached."""
    m = chamfer_metrics(ORIGIN, [[3.0, 4.0, 0.0]], spacing=0.5)
    assert m["s2t"] == m["t2s"] == m["hausdorff"] == 5
    assert m["two_sided"] == math.sqrt(50)
    assert m["s2t_over_h"] == m["t2s_over_h"] == 10
    assert m["precision"] == m["recall"] == m["f1"] == m["coverage"] == 0
    assert m["many_to_one"] == m["targets_used"] == 1
    assert m["overlap_01"] == m["overlap_h10"] == m["escaped"] == 0


def test_two_particles_on_one_target() -> None:
    """The two directions differ: one of two particles is on the only target point."""
    m = chamfer_metrics([[0, 0, 0], [1, 0, 0]], ORIGIN, spacing=1)
    assert (m["s2t"], m["t2s"], m["two_sided"]) == (math.sqrt(0.5), 0, math.sqrt(0.5))
    assert m["hausdorff"] == 1
    assert (m["precision"], m["recall"], m["f1"]) == (0.5, 1, pytest.approx(2 / 3))
    assert (m["many_to_one"], m["targets_used"]) == (0.5, 1)


def test_shifted_lattice_is_the_shift_away() -> None:
    """A lattice moved by less than h/2 is exactly the shift away, both ways."""
    goal = lattice(6, 0.5)
    m = chamfer_metrics(goal + np.array([0.125, 0, 0]), goal, spacing=0.5)
    assert m["s2t"] == m["t2s"] == m["hausdorff"] == 0.125
    assert m["f1"] == m["coverage"] == m["many_to_one"] == 1


def test_thresholds_are_strict() -> None:
    """A point exactly at a threshold is not within it."""
    shifted = [[0.25, 0, 0]]
    assert chamfer_metrics(shifted, ORIGIN, spacing=1, tau=0.25)["f1"] == 0
    assert chamfer_metrics(shifted, ORIGIN, spacing=1, tau=0.2500001)["f1"] == 1
    assert chamfer_metrics(shifted, ORIGIN, spacing=1, coverage_radius=0.25)["coverage"] == 0
    pair = [[0, 0, 0], [0.125, 0, 0]]
    assert chamfer_metrics(pair, ORIGIN, spacing=1.25)["overlap_h10"] == 0
    assert chamfer_metrics(pair, ORIGIN, spacing=1.26)["overlap_h10"] == 1


def test_overlap_counts_every_particle_of_a_clump() -> None:
    """Three coincident, two nearly so, one alone: 3/6 within .01, 5/6 within .1 h."""
    cloud = [[0, 0, 0]] * 3 + [[4, 0, 0], [4.02, 0, 0]] + [[8, 0, 0]]
    m = chamfer_metrics(cloud, ORIGIN, spacing=0.5)
    assert m["overlap_01"] == 3 / 6
    assert m["overlap_h10"] == 5 / 6


def test_coverage_sees_a_hole() -> None:
    """Coverage misses exactly the target points around which no particle lies within .87 h."""
    goal = lattice(5, 1.0)
    hole = np.abs(goal - 2).max(axis=1) == 0
    assert chamfer_metrics(goal[~hole], goal, spacing=1)["coverage"] == 1 - 1 / 125


def test_known_distances_replace_the_search() -> None:
    """Distances found on the device give the same metrics, also where a particle is lost."""
    goal, cloud = jittered(6, 0.5, seed=1), jittered(6, 0.5, seed=2) + 0.1
    d_fwd, nearest = cKDTree(goal).query(cloud)
    d_rev, _ = cKDTree(cloud).query(goal)
    lost = np.concatenate([cloud, [[np.nan, 0, 0]]])
    known = chamfer_metrics(
        lost,
        goal,
        spacing=0.5,
        d_fwd=np.append(d_fwd, np.nan),
        nearest_fwd=np.append(nearest, -1),
        d_rev=d_rev,
    )
    assert known == chamfer_metrics(lost, goal, spacing=0.5)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_lost_particles_are_escaped_and_nothing_else(bad: float) -> None:
    """A non-finite particle changes only the count of escaped ones."""
    goal = jittered(5, 0.5, seed=1)
    cloud = (goal + 0.05).astype(np.float32)
    lost = np.concatenate([cloud, np.float32([[0, bad, 0]])])
    whole = chamfer_metrics(cloud, goal, spacing=0.5)
    assert chamfer_metrics(lost, goal, spacing=0.5) == whole | {"escaped": 1}
    assert fill_metrics(lost, goal, spacing=0.5) == fill_metrics(cloud, goal, spacing=0.5)


def test_nothing_left_is_the_worst_value() -> None:
    """With no finite particle distances are inf and shares their worst, none NaN."""
    lost = np.full((4, 3), np.nan, dtype=np.float32)
    values = chamfer_metrics(lost, ORIGIN, spacing=0.5)
    assert values.keys() == chamfer_metrics(ORIGIN, ORIGIN, spacing=0.5).keys()
    assert values.pop("escaped") == 4
    worst = {
        "lower": {"share": 1.0, "dx": math.inf, "h": math.inf},
        "higher": {"share": 0.0, "h": 0.0},
    }
    for name, value in values.items():
        assert value == worst[METRICS[name].better][METRICS[name].unit], name
    fill = fill_metrics(lost, ORIGIN, spacing=0.5)
    assert fill.keys() == fill_metrics(ORIGIN, ORIGIN, spacing=0.5).keys()
    assert (fill["iou"], fill["cover"], fill["spill"]) == (0, 0, 1)


def test_escaped_counts_who_left_the_box() -> None:
    """The default box is [-14, 14]^3, borders included."""
    cloud = [[14, -14, 0], [14.01, 0, 0], [0, 0, -15], [1e38, 0, 0]]
    assert chamfer_metrics(cloud, ORIGIN, spacing=1)["escaped"] == 3
    assert chamfer_metrics(cloud, ORIGIN, spacing=1, domain_half_extent=15)["escaped"] == 1


@pytest.mark.parametrize("measure", [chamfer_metrics, fill_metrics])
@pytest.mark.parametrize(
    "target", [np.zeros((0, 3)), np.zeros((4, 2)), np.zeros(3), np.full((2, 3), np.nan)]
)
def test_unusable_targets_are_refused(measure, target: Cloud) -> None:
    """A target of the wrong shape, empty or not finite is an error with a remedy."""
    with pytest.raises(MeshError) as error:
        measure(ORIGIN, target, spacing=1)
    assert error.value.remedy


def test_deformation_range() -> None:
    """The identity has det 1; a mirror -1; a lost particle spans everything."""
    identity, mirror = np.eye(3), np.diag([1.0, 1.0, -1.0])
    assert deformation_metrics([identity]) == dict.fromkeys(
        ("det_f_min", "det_f_max", "det_f_mean"), 1
    )
    mixed = deformation_metrics([2 * identity, mirror])
    assert mixed == {"det_f_min": -1, "det_f_max": 8, "det_f_mean": 3.5}
    lost = deformation_metrics([identity, np.full((3, 3), np.nan)])
    assert lost == {"det_f_min": -math.inf, "det_f_max": math.inf, "det_f_mean": math.inf}
    random = np.random.default_rng(3).normal(size=(50, 3, 3))
    det = np.linalg.det(random)
    # two orders of evaluation of six products: a few float64 roundings apart
    expected = {"det_f_min": det.min(), "det_f_max": det.max(), "det_f_mean": det.mean()}
    assert deformation_metrics(random) == pytest.approx(expected, rel=1e-12)


# --- fill --------------------------------------------------------------------------------------


def test_a_cloud_fills_itself() -> None:
    """Identical clouds overlap wholly and have density ratio 1 everywhere."""
    cloud = jittered(10, 1 / 3, seed=4)
    m = fill_metrics(cloud, cloud, spacing=1 / 3)
    assert (m["iou"], m["cover"], m["spill"]) == (1, 1, 0)
    assert {value for name, value in m.items() if name.startswith("rho")} == {1}


def test_fill_does_not_see_the_phase_of_the_lattice() -> None:
    """A lattice half a cell off fills the same volume, where F1 sees every particle misplaced."""
    h = 1 / 3
    goal = jittered(18, h, seed=5)
    cloud = jittered(20, h, seed=6) - h / 2  # half a spacing beyond the target on every side
    m = fill_metrics(cloud, goal, spacing=h)
    # without jitter the balls leave no hole; 10 % of it opens a few at the cells' middles
    assert m["cover"] > 0.995
    assert chamfer_metrics(cloud, goal, spacing=h)["f1"] < 0.1


@pytest.mark.parametrize("spacing", [0.25, 1 / 3, 0.5])
def test_fill_is_the_definition(spacing: float) -> None:
    """Equal to a raster searched node by node over the joint box grown by 1."""
    goal = jittered(9, spacing, seed=7)
    cloud = np.random.default_rng(8).uniform(-1, 3, (500, 3))
    low = np.minimum(goal.min(axis=0), cloud.min(axis=0)) - 1
    high = np.maximum(goal.max(axis=0), cloud.max(axis=0)) + 1
    axes = [np.arange(a, b, 0.25) for a, b in zip(low, high, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    a, b = (cKDTree(points).query(nodes)[0] < 0.87 * spacing for points in (cloud, goal))
    m = fill_metrics(cloud, goal, spacing=spacing)
    assert m["iou"] == np.sum(a & b) / np.sum(a | b)
    assert m["cover"] == np.sum(a & b) / np.sum(b)
    assert m["spill"] == pytest.approx(np.sum(a & ~b) / np.sum(a), rel=1e-12)  # 1 - x rounds once

    here = (np.linalg.norm(goal[:, None] - cloud, axis=2) <= 1).sum(axis=1)
    wanted = (np.linalg.norm(goal[:, None] - goal, axis=2) <= 1).sum(axis=1)
    rho = here / wanted / (len(cloud) / len(goal))
    assert m["rho_p95"] == pytest.approx(np.quantile(rho, 0.95), rel=1e-12)


def test_disjoint_clouds_share_nothing() -> None:
    """Fills that do not meet: nothing covered, all spilt."""
    goal = jittered(5, 0.5, seed=9)
    m = fill_metrics(goal + 20, goal, spacing=0.5)
    assert (m["iou"], m["cover"], m["spill"], m["rho_p99"]) == (0, 0, 1, 0)


def test_density_ratio_shows_what_overlap_hides() -> None:
    """Twice the particles in one half: overlap stays perfect, the ratios are 2/3 and 4/3."""
    goal = jittered(12, 0.5, seed=10)
    left = goal[np.argsort(goal[:, 0])[: len(goal) // 2]]
    m = fill_metrics(np.concatenate([goal, left]), goal, spacing=0.5)
    assert m["iou"] == 1
    assert (m["rho_p05"], m["rho_p95"]) == (pytest.approx(2 / 3), pytest.approx(4 / 3))


def test_far_particles_cost_no_memory() -> None:
    """A particle at the end of float32 takes no part; one at 10^5 is a ball of spill."""
    goal = jittered(6, 0.5, seed=11)
    m = fill_metrics([*goal, [3e38, 0, 0], [0, -1e5, 0]], goal, spacing=0.5)
    assert m["cover"] == 1
    assert 0 < m["spill"] < 0.1


# --- floors of a lattice target (algorithm 9.1) -------------------------------------------------

SAMPLES = 40_000


@pytest.fixture(scope="module")
def floor() -> dict[str, float]:
    """Metrics of particles thrown at random into a lattice of spacing 1/3, tau = .2."""
    goal = lattice(9, 1 / 3)
    cloud = np.random.default_rng(12).uniform(0, 8 / 3, (SAMPLES, 3))
    return chamfer_metrics(cloud, goal, spacing=1 / 3)


def test_floor_of_s2t_is_half_a_spacing(floor: dict[str, float]) -> None:
    """Uncorrelated particles are h/2 rms from a lattice."""
    # d^2 of a point in its cell has mean h^2/4, variance 3 (1/80 - 1/144) h^4 = h^4/60;
    # so s2t/h = 1/2 has standard error 1/sqrt(60 n); four of them
    assert floor["s2t_over_h"] == pytest.approx(0.5, abs=4 / math.sqrt(60 * SAMPLES))


def test_floor_of_precision(floor: dict[str, float]) -> None:
    """Precision at tau = .2 of uncorrelated particles is .798 at h = 1/3."""
    share = 0.798  # itself a Monte Carlo value to three digits
    error = 4 * math.sqrt(share * (1 - share) / SAMPLES) + 0.0005
    assert floor["precision"] == pytest.approx(share, abs=error)


def test_floors_of_a_random_source() -> None:
    """A random source of equal density: t2s, coverage and distinct targets have closed forms."""
    count, h = 30, 1.0
    goal = lattice(count, h)
    # the source reaches two spacings beyond the targets, so that none lies at its border
    width = count + 4
    cloud = np.random.default_rng(13).uniform(-2.5, count + 1.5, (width**3, 3))
    m = chamfer_metrics(cloud, goal, spacing=h, domain_half_extent=100)
    # n targets count as n/4 independent ones: neighbours share the particles around them
    error = 4 / math.sqrt(len(goal) / 4)
    ball = 4 / 3 * math.pi
    mean_square = math.gamma(5 / 3) / ball ** (2 / 3)  # .5894^2; spread of d^2 is .64 of it
    assert m["t2s"] ** 2 == pytest.approx(mean_square, rel=0.64 * error)
    empty = math.exp(-ball * 0.87**3)
    assert m["coverage"] == pytest.approx(1 - empty, abs=error * math.sqrt(empty))
    inside = (np.abs(cloud - (count - 1) / 2) < count / 2).all(axis=1)
    m = chamfer_metrics(cloud[inside], goal, spacing=h, domain_half_extent=100)
    assert m["targets_used"] == pytest.approx(1 - math.exp(-1), abs=0.5 * error)


# --- properties ---------------------------------------------------------------------------------


@properties
@given(clouds, clouds)
def test_exchange_swaps_the_directions(a: Cloud, b: Cloud) -> None:
    """Swapping the clouds swaps s2t with t2s and precision with recall, and nothing symmetric."""
    ab, ba = chamfer_metrics(a, b, spacing=0.5), chamfer_metrics(b, a, spacing=0.5)
    for one, other in [("s2t", "t2s"), ("precision", "recall")]:
        assert (ab[one], ab[other]) == (ba[other], ba[one])
    for name in ("two_sided", "hausdorff", "f1"):
        assert ab[name] == ba[name]
    assert ab["two_sided"] ** 2 == pytest.approx(ab["s2t"] ** 2 + ab["t2s"] ** 2, rel=1e-14)
    # rounding of the square and its root
    assert ab["hausdorff"] * (1 + 1e-14) >= max(ab["s2t"], ab["t2s"])
    fill_ab, fill_ba = fill_metrics(a, b, spacing=0.5), fill_metrics(b, a, spacing=0.5)
    assert fill_ab["iou"] == fill_ba["iou"]
    assert fill_ab["cover"] == pytest.approx(1 - fill_ba["spill"], abs=1e-15)


@properties
@given(clouds, clouds, st.integers(0, 2**31))
def test_distances_do_not_see_a_rigid_motion(a: Cloud, b: Cloud, seed: int) -> None:
    """Turning and moving both clouds together, in any order of points, changes no distance."""
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.from_quat(rng.normal(size=4)), rng.uniform(-4, 4, 3)
    before = chamfer_metrics(a, b, spacing=0.5)
    after = chamfer_metrics(
        turn.apply(rng.permutation(a)) + shift, turn.apply(rng.permutation(b)) + shift, spacing=0.5
    )
    for name in ("s2t", "t2s", "two_sided", "hausdorff"):
        # coordinates below 20 rounded to 2^-53, a few operations each
        assert after[name] == pytest.approx(before[name], abs=1e-13)


@properties
@given(clouds, clouds, st.sampled_from([0.25, 0.5, 2.0, 8.0]))
def test_numbers_over_h_do_not_see_the_unit(a: Cloud, b: Cloud, scale: float) -> None:
    """Scaling everything, h included, keeps whatever is measured in units of h (exact: 2^k)."""
    before = chamfer_metrics(a, b, spacing=0.5)
    after = chamfer_metrics(a * scale, b * scale, spacing=0.5 * scale)
    for name in ("s2t_over_h", "t2s_over_h", "two_sided_over_h", "coverage", "overlap_h10"):
        assert after[name] == pytest.approx(before[name], rel=1e-14), name


@properties
@given(clouds, st.integers(2, 4))
def test_copies_are_overlap_and_nothing_else(a: Cloud, copies: int) -> None:
    """Stacking k copies of a cloud changes no distance; all overlap; k share each target."""
    distinct = np.unique(a, axis=0)
    m = chamfer_metrics(np.tile(distinct, (copies, 1)), distinct, spacing=0.5)
    assert m["two_sided"] == 0
    assert m["overlap_01"] == m["targets_used"] == 1
    assert m["many_to_one"] == 1 / copies
