"""Nearest neighbours are exact in every case (algorithm 5.1)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morph_engine import backend
from morph_engine.backend import Precision
from morph_engine.geometry.neighbor_index import LEAF_SIZE, NO_MATCH, NeighborIndex, leaf_order

Array = NDArray[np.floating[Any]]
ROUNDING = {"float32": 4e-7, "float64": 1e-15}  # a few units in the last place


@pytest.fixture(scope="module", params=["float32", "float64"])
def precision(request: pytest.FixtureRequest) -> Precision:
    """All tests in one, then all in the other: Taichi takes half a second for a change."""
    chosen: Precision = request.param
    return chosen


@pytest.fixture
def device(precision: Precision) -> backend.Backend:
    """Taichi on two threads, in both precisions."""
    return backend.start("cpu", threads=2, precision=precision)


def find(
    index: NeighborIndex, queries: Array, guess: NDArray[np.int32] | None = None
) -> tuple[NDArray[np.int32], Array]:
    """Ask for the nearest points of host queries; the answers as host arrays."""
    device = backend.active()
    matches, distances = device.integers(len(queries)), device.scalars(len(queries))
    if guess is not None:
        matches.from_numpy(guess)
    index.nearest(device.upload(queries), matches, distances, None if guess is None else matches)
    return matches.to_numpy(), distances.to_numpy()


def require_exact(points: Array, queries: Array, matches: NDArray[np.int32], distances: Array):
    """Each answer is as near as the best one, up to rounding, and its distance is its own."""
    numpy_real = backend.active().numpy_real
    points, queries = points.astype(numpy_real), queries.astype(numpy_real)
    best, _ = cKDTree(points).query(queries)
    own = np.linalg.norm(queries.astype(float) - points[matches].astype(float), axis=1)
    scale = ROUNDING[backend.active().precision] * (np.abs(queries).max(axis=1) + best)
    assert np.all(own - best <= scale)
    np.testing.assert_array_less(np.abs(distances - own), scale + np.finfo(float).tiny)


@pytest.mark.parametrize("lanes", [1, 8])
@pytest.mark.parametrize("count", [1, 2, LEAF_SIZE, LEAF_SIZE + 1, 500, 5000])
def test_random_clouds(device: backend.Backend, count: int, lanes: int) -> None:
    """Near, far and very far queries, in any number and order."""
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3))
    index = NeighborIndex(device.upload(points), lanes=lanes)
    for queries in (
        rng.normal(size=(1, 3)),
        rng.normal(size=(777, 3)),
        rng.uniform(-9, 9, (300, 3)) + np.array([20.0, 0.0, 0.0]),
        rng.normal(size=(50, 3)) * 1e6,
    ):
        require_exact(points, queries, *find(index, queries))


@pytest.mark.parametrize("shape", ["line", "plane", "pile"])
def test_degenerate_clouds(device: backend.Backend, shape: str) -> None:
    """Collinear, coplanar and heavily repeated points."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(900, 3))
    if shape == "line":
        points[:, 1:] = 0.5
    elif shape == "plane":
        points[:, 2] = -1.0
    else:
        points[:] = points[rng.integers(0, 7, 900)]
    queries = rng.normal(size=(400, 3))
    require_exact(points, queries, *find(NeighborIndex(device.upload(points)), queries))


@pytest.mark.parametrize("lanes", [1, 8])
def test_ties_take_the_lowest_index(device: backend.Backend, lanes: int) -> None:
    """On a shuffled, doubled integer lattice all squared distances are exact, ties abound."""
    rng = np.random.default_rng(5)
    ticks = np.arange(7.0)
    lattice = np.stack(np.meshgrid(ticks, ticks, ticks), axis=-1).reshape(-1, 3)
    points = rng.permutation(np.concatenate([lattice, lattice]))
    queries = np.concatenate([lattice + 0.5, lattice + np.array([0.5, 0.0, 0.0]), lattice])
    squared = ((queries[:, None] - points[None]) ** 2).sum(axis=2)
    matches, distances = find(NeighborIndex(device.upload(points), lanes=lanes), queries)
    np.testing.assert_array_equal(matches, squared.argmin(axis=1))
    np.testing.assert_allclose(
        distances, np.sqrt(squared.min(axis=1)), rtol=ROUNDING[device.precision]
    )


@pytest.mark.parametrize("lanes", [1, 8])
def test_queries_that_are_not_finite_find_nothing(device: backend.Backend, lanes: int) -> None:
    """They end with index -1 at distance inf, and do not disturb their neighbours."""
    rng = np.random.default_rng(6)
    points, queries = rng.normal(size=(300, 3)), rng.normal(size=(100, 3))
    lost = np.array([0, 8, 9, 50, 99])
    clean = np.delete(np.arange(100), lost)
    queries[lost, lost % 3] = [np.nan, np.inf, -np.inf, 1e30, -1e19]
    matches, distances = find(NeighborIndex(device.upload(points), lanes=lanes), queries)
    assert np.all(matches[lost] == -1) and np.all(np.isposinf(distances[lost]))
    require_exact(points, queries[clean], matches[clean], distances[clean])


def test_points_that_are_not_finite_are_never_found(device: backend.Backend) -> None:
    """A lost point returns with its next finite position; without points there is no answer."""
    rng = np.random.default_rng(7)
    points, queries = rng.normal(size=(200, 3)), rng.normal(size=(100, 3))
    damaged = points.copy()
    damaged[::2, 1] = np.nan
    damaged[1, 0] = np.inf
    index = NeighborIndex(device.upload(damaged))
    present = np.isfinite(damaged).all(axis=1)
    matches, distances = find(index, queries)
    assert np.all(present[matches])
    renumbered = np.cumsum(present) - 1
    require_exact(points[present], queries, renumbered[matches], distances)
    index.update(device.upload(points))
    require_exact(points, queries, *find(index, queries))
    index.update(device.upload(np.full_like(points, np.nan)))
    matches, distances = find(index, queries)
    assert np.all(matches == -1) and np.all(np.isposinf(distances))


@pytest.mark.parametrize("method", ["update", "rebuild"])
def test_moved_points(device: backend.Backend, method: str) -> None:
    """After any motion, even a shuffle, answers are exact again."""
    rng = np.random.default_rng(8)
    points, queries = rng.normal(size=(3000, 3)), rng.normal(size=(1000, 3))
    index = NeighborIndex(device.upload(points))
    for moved in (points + 0.1 * rng.normal(size=points.shape), 3 * points, points[::-1]):
        getattr(index, method)(device.upload(moved))
        require_exact(moved, queries, *find(index, queries))


def test_guesses_do_not_change_answers(device: backend.Backend) -> None:
    """Right, wrong and senseless guesses lead to bitwise the same answers."""
    rng = np.random.default_rng(9)
    points, queries = rng.normal(size=(2000, 3)), rng.normal(size=(1500, 3))
    index = NeighborIndex(device.upload(points))
    matches, distances = find(index, queries)
    senseless = rng.integers(-(2**31), 2**31 - 1, 1500).astype(np.int32)
    for guess in (matches, rng.integers(0, 2000, 1500).astype(np.int32), senseless):
        guided_matches, guided_distances = find(index, queries, guess)
        np.testing.assert_array_equal(guided_matches, matches)
        np.testing.assert_array_equal(guided_distances, distances)


def test_threads_do_not_change_answers() -> None:
    """One and two threads give bitwise the same answers."""
    rng = np.random.default_rng(10)
    points, queries = rng.normal(size=(9000, 3)), rng.normal(size=(9000, 3))
    answers = []
    for threads in (1, 2):
        device = backend.start("cpu", threads=threads)
        answers.append(find(NeighborIndex(device.upload(points)), queries))
    np.testing.assert_array_equal(answers[0][0], answers[1][0])
    np.testing.assert_array_equal(answers[0][1], answers[1][1])


def test_arrays_of_wrong_length_are_refused(device: backend.Backend) -> None:
    """Writing past the end of an array would end the process."""
    points = device.vectors(10)
    index = NeighborIndex(points)
    with pytest.raises(ValueError, match="10 queries"):
        index.nearest(points, device.integers(9), device.scalars(10))
    with pytest.raises(ValueError, match="11 points for an index of 10"):
        index.update(device.vectors(11))


@pytest.mark.parametrize("count", [1, 33, 1000])
def test_leaves_hold_every_point_once(count: int) -> None:
    """Leaves fill up one after the other, and list their points in ascending order."""
    points = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    points[count // 2] = np.nan
    order = leaf_order(points, 64)
    assert order.shape == (64 * LEAF_SIZE,)
    np.testing.assert_array_equal(np.sort(order)[:count], np.arange(count))
    assert np.all(np.sort(order)[count:] == NO_MATCH)
    assert np.all(np.diff(order.reshape(64, LEAF_SIZE).astype(np.int64), axis=1) >= 0)
