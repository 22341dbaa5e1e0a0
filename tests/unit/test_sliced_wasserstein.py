"""The sliced Wasserstein distance against what is known of it."""

import numpy as np
import pytest

from morph_engine import backend
from morph_engine.losses.sliced_wasserstein import SlicedWasserstein


@pytest.fixture
def target() -> np.ndarray:
    """Points of no particular order."""
    return np.random.default_rng(5).normal(size=(300, 3))


def test_a_shift_costs_half_its_square(float64_device, target):
    """L = d^2 / 2 on average over lines; exactly so for many of them."""
    shift = np.array([0.6, -0.2, 0.3])
    loss = SlicedWasserstein(target, backend.active().upload(target + shift), 4096)
    assert loss.value() == pytest.approx(0.5 * shift @ shift, rel=0.05)


def test_two_particles_to_a_target_point_cost_nothing(float64_device, target):
    """Mass counts, not number; half the target's points alone do cost."""
    device = backend.active()
    twice = SlicedWasserstein(target, device.upload(np.repeat(target, 2, axis=0)), 8)
    half = SlicedWasserstein(target, device.upload(target[:150]), 8)
    assert twice.value() == pytest.approx(0, abs=1e-20)
    assert half.value() > 1e-4


def test_the_gradient_is_that_of_the_value(float64_device, target):
    """Central differences; ranks do not change for steps this small."""
    device = backend.active()
    positions = np.random.default_rng(6).normal(size=(200, 3))
    x, gradient = device.upload(positions), device.vectors(200)
    loss = SlicedWasserstein(target, x, 6)
    loss.gradient(x, gradient)
    direction = np.random.default_rng(7).normal(size=(200, 3))
    values = []
    for step in (1e-7, -1e-7):
        x.from_numpy(positions + step * direction)
        values.append(loss.value())
    slope = (values[0] - values[1]) / 2e-7
    assert slope == pytest.approx(np.sum(gradient.to_numpy() * direction), rel=1e-5)
