"""Destinations that fill a target evenly, the plan that hands them out, and the method."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from morph_engine import morph
from morph_engine.geometry.sampling import sample_lattice
from morph_engine.geometry.shapes import make
from morph_engine.optimal_transport import even_destinations, random_destinations, transport_plan
from morph_engine.optimal_transport.partition import split, spread
from morph_engine.presets import configure

SPACING = 0.5


@pytest.fixture(scope="module")
def star() -> np.ndarray:
    """A jittered lattice, as the published sampling gives it."""
    return sample_lattice(make("star"), spacing=SPACING).astype(np.float64)


@pytest.mark.parametrize("count", [1, 2, 7, 100, 999])
def test_groups_are_a_partition_into_equal_parts(count):
    """Every point is in one group; sizes differ by little."""
    points = np.random.default_rng(1).normal(size=(1000, 3))
    groups = split(points, count, np.random.default_rng(2))
    assert sorted(groups.order) == list(range(1000))
    assert len(groups.sizes) == count
    assert groups.sizes.min() >= 1
    assert np.ptp(groups.sizes) <= 2


def test_spread_chooses_each_point_once():
    """Chosen points differ, and none at all may be chosen."""
    points = np.random.default_rng(1).normal(size=(500, 3))
    assert len(set(spread(points, 200, np.random.default_rng(2)))) == 200
    assert len(spread(points, 0, np.random.default_rng(2))) == 0


@pytest.mark.parametrize("ratio", [0.2, 0.6, 0.9, 1.0, 1.1, 1.7, 2.6])
def test_there_is_a_place_for_each_particle_and_a_particle_for_each_place(star, ratio):
    """Counts are exact, no two places are close, and every target point has one near by."""
    count = round(ratio * len(star))
    places = even_destinations(star, count, SPACING)
    assert places.shape == (count, 3)
    apart = cKDTree(places).query(places, k=2)[0][:, 1]
    assert apart.min() > 0.2 * SPACING
    reach = cKDTree(places).query(star)[0]
    if ratio >= 0.6:  # a shared place is half a spacing away, and the jitter a fifth more
        assert reach.max() < 0.65 * SPACING
    else:
        assert reach.mean() < SPACING


def test_places_are_evenly_dense(star):
    """A ball of two spacings holds nearly the same share of the places everywhere."""
    places = even_destinations(star, round(1.2 * len(star)), SPACING)
    inside = cKDTree(star).query_ball_point(star, 2 * SPACING, return_length=True)
    placed = cKDTree(places).query_ball_point(star, 2 * SPACING, return_length=True)
    assert np.quantile(placed / inside, [0.05, 0.95]) / 1.2 == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("ratio", [0.3, 0.7, 0.9, 0.97, 1.3, 2.6])
def test_a_cloud_that_is_no_lattice_gives_every_particle_a_place(ratio):
    """Several points in a cell of the lattice do not confuse it."""
    rng = np.random.default_rng(5)
    ball = rng.normal(size=(6000, 3))
    ball *= 5 * rng.uniform(size=(6000, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1, keepdims=True)
    count = int(ratio * len(ball))
    places = even_destinations(ball, count, SPACING)
    assert len(places) == count and np.isfinite(places).all()
    assert np.linalg.norm(places, axis=1).max() < 5 + SPACING


def test_random_places_are_target_points_and_none_is_taken_twice_before_all_are_taken(star):
    """Fewer: each at most once. More: each once, some twice."""
    few = random_destinations(star, len(star) // 2)
    assert len(np.unique(few, axis=0)) == len(few)
    many = random_destinations(star, len(star) * 3 // 2)
    found, times = np.unique(many, axis=0, return_counts=True)
    assert len(found) == len(star) and times.max() == 2


def test_the_plan_is_within_two_per_cent_of_the_optimum():
    """A permutation, compared with the exact assignment."""
    rng = np.random.default_rng(3)
    source = rng.normal(size=(1500, 3))
    places = rng.uniform((-1, -2, -2), (3, 2, 2), size=(1500, 3))
    plan = transport_plan(source, places, group=200)
    assert sorted(plan) == list(range(1500))
    cost = np.sum((source - places[plan]) ** 2)
    squared = np.sum((source[:, None] - places) ** 2, axis=2)
    assert cost < 1.02 * squared[linear_sum_assignment(squared)].sum()


def test_particles_arrive_and_nothing_is_lost_on_the_way():
    """The target is filled: every particle at a place, none close to another, no inversion."""
    config = configure(
        "fast", {"method": "transport", "frames": 12, "sampling.points_per_cell_edge": 1}
    )
    frames = list(morph("sphere", "star", config))
    assert frames[-1].metrics["loss_transport"] < 1e-6
    assert frames[-1].metrics["two_sided_over_h"] < 0.1
    assert frames[-1].metrics["iou"] > 0.99
    for frame in frames:
        assert frame.metrics["overlap_h10"] == 0
        assert frame.metrics["det_f_min"] > 0.8  # matter is let go at 0.5
