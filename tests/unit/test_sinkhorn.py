"""The Sinkhorn divergence against what is known of it."""

import numpy as np
import pytest

from morph_engine import backend
from morph_engine.losses.sinkhorn import SinkhornDivergence
from morph_engine.mpm.grid import Grid

GRID = Grid(dx=1.0, half_extent=5.0)


def cloud(seed: int, count: int = 200) -> np.ndarray:
    """Points in the middle of the domain."""
    return np.random.default_rng(seed).uniform(-1.5, 1.5, size=(count, 3))


def divergence(target: np.ndarray, positions: np.ndarray, rounds: int = 30):
    """The loss, and the device array of the particles."""
    device = backend.active()
    x = device.upload(positions)
    loss = SinkhornDivergence(device.upload(target), x, grid=GRID, blur=1.0, rounds=rounds)
    return loss, x


def test_equal_masses_have_no_divergence(float64_device):
    """Zero at equality, whatever the number of points; positive otherwise."""
    target = cloud(1)
    assert divergence(target, np.repeat(target, 2, axis=0))[0].value() == pytest.approx(0, abs=1e-9)
    assert divergence(target, cloud(2))[0].value() > 1e-4


def test_a_shift_by_whole_cells_costs_half_its_square(float64_device):
    """S = d^2 / 2 for translated copies, as optimal transport has it."""
    target = cloud(1)
    loss, _ = divergence(target, target + np.array([2.0, 0.0, 0.0]), rounds=100)
    assert loss.value() == pytest.approx(2.0, rel=1e-3)


def test_the_gradient_is_that_of_the_value(float64_device):
    """Central differences, with potentials that have converged."""
    positions, target = cloud(3), cloud(1)
    loss, x = divergence(target, positions, rounds=100)
    gradient = backend.active().vectors(len(positions))
    loss.gradient(x, gradient)
    direction = np.random.default_rng(7).normal(size=positions.shape)
    values = []
    for step in (1e-4, -1e-4):
        x.from_numpy(positions + step * direction)
        values.append(loss.value())
    slope = (values[0] - values[1]) / 2e-4
    assert slope == pytest.approx(np.sum(gradient.to_numpy() * direction), rel=1e-4)
