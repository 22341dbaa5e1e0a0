"""Grid mass and Chamfer losses: values, gradients, smoothing (algorithm 3, 5, 13.1)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.losses.cell_search import search_cells
from morph_engine.losses.chamfer import ChamferLoss
from morph_engine.losses.gaussian_smoothing import GaussianSmoothing
from morph_engine.losses.grid_mass import GridMass, GridMassLoss
from morph_engine.losses.matches import Matches
from morph_engine.mpm.grid import Grid
from morph_engine.sections import ChamferConfig

pytestmark = pytest.mark.usefixtures("float64_device")
GRID = Grid(half_extent=4.0)
PLAIN = ChamferConfig(huber_delta=0, reverse_clamp=0, reverse_smoothing=0)
Points = NDArray[np.float64]


def clouds(n: int = 300, m: int = 250) -> tuple[Points, Points]:
    """Two overlapping random clouds."""
    rng = np.random.default_rng(4)
    return rng.uniform(-2, 2, (n, 3)), rng.uniform(-1, 2.5, (m, 3))


def test_grid_loss_is_that_of_the_formula() -> None:
    """The loss equals half the squared log ratios over all nodes."""
    x, target = clouds()
    device = backend.active()
    loss = GridMassLoss(
        device.upload(target), particle_count=300, point_mass=2.0, grid=GRID, outside_factor=1.0
    )
    masses = [
        GridMass(len(points), 2.0, GRID).gather(device.upload(points)).to_numpy()
        for points in (x, target)
    ]
    g = np.log(masses[0] + 1.0001) - np.log(masses[1] + 1.0001)
    assert loss.evaluate(device.upload(x)) == pytest.approx(0.5 * np.sum(g * g), rel=1e-12)


def test_grid_loss_gradient_matches_differences() -> None:
    """With the same factor everywhere, the gradient is that of the loss."""
    x, target = clouds()
    device = backend.active()
    loss = GridMassLoss(
        device.upload(target), particle_count=300, point_mass=2.0, grid=GRID, outside_factor=1.0
    )
    gradient = device.vectors(300)
    at = device.upload(x)
    loss.evaluate(at)
    loss.gradient(at, gradient)
    direction = np.random.default_rng(5).normal(size=x.shape)
    step = 1e-6
    values = [loss.evaluate(device.upload(x + s * step * direction)) for s in (1, -1)]
    difference = (values[0] - values[1]) / (2 * step)
    assert np.sum(gradient.to_numpy() * direction) == pytest.approx(difference, rel=1e-7)


@pytest.mark.parametrize("delta", [0.0, 0.3])
def test_chamfer_gradient_matches_differences(delta: float) -> None:
    """Assignments do not change over a tiny step, so differences see the frozen gradient."""
    x, target = clouds()
    device = backend.active()
    loss = ChamferLoss(
        Matches(device.upload(target), device.upload(x)),
        PLAIN.model_copy(update={"huber_delta": delta}),
        GRID,
    )
    gradient = device.vectors(300)
    at = device.upload(x)
    loss.evaluate(at, 0.7)
    loss.add_gradient(at, gradient, 3.0, 0.7)
    direction = np.random.default_rng(6).normal(size=x.shape)
    step = 1e-7
    values = [loss.evaluate(device.upload(x + s * step * direction), 0.7) for s in (1, -1)]
    difference = 3.0 * (values[0] - values[1]) / (2 * step)
    assert np.sum(gradient.to_numpy() * direction) == pytest.approx(difference, rel=1e-6)


def test_forward_gradient_pulls_to_the_nearest_target() -> None:
    """(2 / N)(x - q), without a reverse term."""
    x, target = clouds()
    device = backend.active()
    at, goal = device.upload(x), device.upload(target)
    loss = ChamferLoss(Matches(goal, at), PLAIN, GRID)
    gradient = device.vectors(300)
    loss.evaluate(at, 0.0)
    loss.add_gradient(at, gradient, 1.0, 0.0)
    nearest = target[np.argmin(np.linalg.norm(x[:, None] - target, axis=2), axis=1)]
    np.testing.assert_allclose(gradient.to_numpy(), 2 / 300 * (x - nearest), atol=1e-15)


def test_clamp_bounds_the_reverse_gradient() -> None:
    """No particle is pulled by more than kappa times the mean pull of the active ones."""
    x, target = clouds(300, 3000)
    device = backend.active()
    at, goal = device.upload(x), device.upload(target)
    pulls = []
    for kappa in (0.0, 1.5):
        loss = ChamferLoss(
            Matches(goal, at), PLAIN.model_copy(update={"reverse_clamp": kappa}), GRID
        )
        both, forward = device.vectors(300), device.vectors(300)
        loss.evaluate(at, 1.0)
        loss.add_gradient(at, both, 1.0, 1.0)
        loss.add_gradient(at, forward, 1.0, 0.0)
        pulls.append(np.linalg.norm(both.to_numpy() - forward.to_numpy(), axis=1))
    free, clamped = pulls
    limit = 1.5 * free[free > 1e-10].mean()
    assert free.max() > limit
    np.testing.assert_allclose(clamped, np.minimum(free, limit), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(("sigma", "tolerance"), [(2.0, 2e-3), (3.0, 5e-4)])
def test_gaussian_average_matches_the_sum_over_neighbours(sigma: float, tolerance: float) -> None:
    """The interpolation error against the direct sum over 27 cells is as documented."""
    rng = np.random.default_rng(7)
    x = rng.uniform(-3, 3, (2000, 3))
    values = rng.normal(size=(2000, 3)) * (rng.random((2000, 1)) < 0.2)
    device = backend.active()
    averages = device.upload(values)
    GaussianSmoothing(GRID, sigma).apply(device.upload(x), averages)
    cells = np.floor(x)
    adjacent = (np.abs(cells[:, None] - cells).max(axis=2) <= 1).astype(float)
    squared = ((x[:, None] - x) ** 2).sum(axis=2)
    weight = adjacent * np.exp(-squared / (2 * sigma**2))
    expected = weight @ values / weight.sum(axis=1, keepdims=True)
    error = np.abs(averages.to_numpy() - expected).max() / np.abs(expected).max()
    assert error < tolerance


def test_published_search_sees_27_cells_only() -> None:
    """Each answer is the nearest point of the neighbouring cells, or none."""
    rng = np.random.default_rng(8)
    points, queries = rng.uniform(-1.5, 1.5, (300, 3)), rng.uniform(-4, 4, (400, 3))
    index, distance = search_cells(queries, points, GRID)
    for query, found, gap in zip(queries, index, distance, strict=True):
        near = np.flatnonzero((np.abs(np.floor(points) - np.floor(query)) <= 1).all(axis=1))
        if len(near) == 0:
            assert found == -1 and gap == np.inf
        else:
            gaps = np.linalg.norm(points[near] - query, axis=1)
            assert found == near[gaps.argmin()]
            assert gap == pytest.approx(gaps.min(), rel=1e-12)
