"""The kernels behind the metrics of a fill give the numbers of their definitions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from morph_engine import backend
from morph_engine.backend import Precision
from morph_engine.metrics import ball_counts, volume
from morph_engine.metrics.ball_counts import BallCounts
from morph_engine.metrics.volume import fill_metrics

Cloud = npt.NDArray[np.float32]


@pytest.fixture(scope="module", params=["float32", "float64"])
def precision(request: pytest.FixtureRequest) -> Precision:
    """All tests in one, then all in the other: Taichi takes half a second for a change."""
    chosen: Precision = request.param
    return chosen


@pytest.fixture(autouse=True)
def device(precision: Precision) -> backend.Backend:
    """Taichi on two threads, in both precisions."""
    return backend.start("cpu", threads=2, precision=precision)


def lattice(count: int, spacing: float, jitter: float = 0.0) -> Cloud:
    """A cube of points, each coordinate off its node by up to a share of the spacing."""
    nodes = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    off = np.random.default_rng(count).uniform(-jitter, jitter, nodes.shape)
    return (spacing * (nodes + off) - 1.7).astype(np.float32)


def counted(particles: Cloud, goal: Cloud, radius: float) -> npt.NDArray[np.intp]:
    """Particles within the radius of each target point, by all distances in float64."""
    apart = particles.astype(np.float64) - goal.astype(np.float64)[:, None]
    return (np.square(apart).sum(axis=2) <= radius * radius).sum(axis=1)


CLOUDS: dict[str, tuple[Cloud, float]] = {
    "one point": (np.float32([[3, -2, 1]]), 0.3),
    "lattice": (lattice(11, 0.25), 0.25),
    "published lattice": (lattice(11, 1 / 3, 0.1), 1 / 3),
    "random": (np.random.default_rng(1).uniform(-2, 2, (1500, 3)).astype(np.float32), 0.35),
    "flat": (
        np.random.default_rng(2).uniform(-2, 2, (700, 3)).astype(np.float32)
        * np.float32([1, 1, 0]),
        0.2,
    ),
    "heap": (np.random.default_rng(3).normal(0, 0.02, (900, 3)).astype(np.float32), 0.5),
}


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("radius", [0.7, 1.0])
def test_counts_are_those_of_all_distances(name: str, radius: float) -> None:
    """Of the points themselves, of random particles, and of heaps and strays."""
    goal, spacing = CLOUDS[name]
    rng = np.random.default_rng(4)
    counts = BallCounts(goal, spacing, radius)
    assert counts.possible
    around = rng.uniform(-3, 3, (2000, 3))
    heap = goal[0] + rng.normal(0, 0.05, (3000, 3))
    far = [[1e6, 0, 0], [0, -3e38, 0]]
    for particles in (goal, around, np.concatenate([heap, around[:500], far])):
        cloud = np.asarray(particles, np.float32)
        np.testing.assert_array_equal(counts.of(cloud), counted(cloud, goal, radius))


def test_points_on_the_sphere_count() -> None:
    """Six neighbours of a lattice are exactly at the radius, in every place."""
    nodes = np.stack(np.meshgrid(*[np.arange(-4, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    goal = (nodes / 4).astype(np.float32)
    middle = np.flatnonzero((goal == 0).all(axis=1))
    assert BallCounts(goal, 0.25, 1.0).of(goal)[middle] == [257]  # i^2 + j^2 + k^2 <= 16


def test_room_for_cut_particles_fills_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """More particles than there is room for are looked at in turns."""
    goal = lattice(4, 0.25, 0.1)
    particles = np.random.default_rng(5).uniform(-3, 3, (30 * ball_counts.ROOM, 3))
    cloud = particles.astype(np.float32)
    found = BallCounts(goal, 0.25, 1.0).of(cloud)
    np.testing.assert_array_equal(found[:3], counted(cloud, goal[:3], 1.0))


def test_scattered_points_take_no_bins() -> None:
    """A target that is far wider than its spacing is left to a search."""
    goal = np.random.default_rng(6).uniform(-1e3, 1e3, (50, 3)).astype(np.float32)
    assert not BallCounts(goal, 0.3, 1.0).possible


@pytest.mark.parametrize("spacing", [0.125, 0.25, 1 / 3, 0.5])
def test_fill_is_the_same_with_kernels(spacing: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal to the last bit to what sets and trees of all points give."""
    goal = lattice(12, spacing, 0.1)
    cloud = np.random.default_rng(7).uniform(goal.min(), goal.max(), (2000, 3)).astype(np.float32)
    measured = fill_metrics(cloud, goal, spacing=spacing)
    monkeypatch.setattr(volume.backend, "runs_on_cpu", lambda: False)
    assert fill_metrics(cloud, goal, spacing=spacing) == measured


@pytest.mark.parametrize("spacing", [0.125, 0.25])
def test_density_at_some_points_is_that_at_all(
    spacing: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Quantiles over a sample differ by its error alone; trees count the same there."""
    goal = lattice(16, spacing, 0.1)
    cloud = np.random.default_rng(7).uniform(goal.min(), goal.max(), (9000, 3)).astype(np.float32)
    whole = fill_metrics(cloud, goal, spacing=spacing)
    monkeypatch.setattr(volume, "MOST_PLACES", 1000)
    some = fill_metrics(cloud, goal, spacing=spacing)
    assert some == fill_metrics(cloud, goal, spacing=spacing)
    wanted = np.random.default_rng(0).choice(len(goal), 1000, replace=False)
    ratio = volume.density_ratio(*(np.float64(each) for each in (cloud, goal)))
    assert some != whole
    for name, quantile in volume.QUANTILES.items():
        # within four standard errors of the rank of a quantile of 1000
        error = 4 * np.sqrt(quantile * (1 - quantile) / 1000)
        low, high = np.quantile(ratio, np.clip([quantile - error, quantile + error], 0, 1))
        assert low <= some[name] <= high
        assert some[name] == pytest.approx(np.quantile(ratio[wanted], quantile))
    monkeypatch.setattr(volume.backend, "runs_on_cpu", lambda: False)
    assert fill_metrics(cloud, goal, spacing=spacing) == some
