"""The hand-written adjoint against central differences, in float64 (algorithm 4, 13.1)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.mpm.constitutive import FIXED_COROTATED, NEO_HOOKEAN
from morph_engine.mpm.grid import Grid
from morph_engine.mpm.scheme import PUBLISHED
from morph_engine.mpm.simulation import Material, Simulation
from morph_engine.mpm.state import Particles
from morph_engine.sections import AdjointConfig

Array = NDArray[np.float64]
PARTICLE_COUNT = 60
TRANSITIONS = 4
NAMES = ("x", "v", "C", "F")


@pytest.fixture(autouse=True)
def float64_device() -> Iterator[None]:
    """Gradient tests need float64."""
    backend.start("cpu", precision="float64")
    yield


def random_simulation(
    model: int, width: int, adjoint: AdjointConfig | None = None
) -> tuple[Simulation, Particles, Array]:
    """A small crowded cloud with random state and control."""
    rng = np.random.default_rng(7)
    n = PARTICLE_COUNT
    noise = lambda *shape: rng.normal(size=shape)  # noqa: E731
    particles = Particles(
        x=rng.uniform(-1.5, 1.5, (n, 3)),
        v=3 * noise(n, 3),
        C=noise(n, 3, 3),
        F=np.eye(3) + 0.1 * noise(n, 3, 3),
    )
    simulation = Simulation(
        rng.uniform(0.03, 0.06, n),
        grid=Grid(half_extent=4.0, width=width),
        material=Material(model, 38888.89, 58333.3, 2.7, 0.5),
        dt=1 / 120,
        transitions=TRANSITIONS,
        domain=3.5,
        adjoint=adjoint or AdjointConfig(),
    )
    simulation.smoothing = 0.9
    control = 0.02 * noise(TRANSITIONS, n, 3, 3)
    for transition, value in zip(simulation.transitions, control, strict=True):
        transition.U.from_numpy(value)
    simulation.layers[0].upload(particles)
    return simulation, particles, control


def terminal_weights() -> Particles:
    """A random linear functional of the last layer; its value is the loss."""
    rng = np.random.default_rng(11)
    n = PARTICLE_COUNT
    return Particles(
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3, 3)),
        rng.normal(size=(n, 3, 3)),
    )


def loss(simulation: Simulation, first: int) -> float:
    """Simulate from a layer and evaluate the functional."""
    assert simulation.forward(first) == 0
    end, weights = simulation.last.download(), terminal_weights()
    return float(sum(np.sum(getattr(end, a) * getattr(weights, a)) for a in NAMES))


@pytest.mark.parametrize("layer", [0, 2, 3])
@pytest.mark.parametrize("width", [4, 3], ids=["cubic", "quadratic"])
@pytest.mark.parametrize("model", [NEO_HOOKEAN, FIXED_COROTATED], ids=["neo", "corotated"])
def test_adjoint_matches_central_differences(model: int, width: int, layer: int) -> None:
    """Every gradient agrees with a directional difference to 1e-6, the error of the difference."""
    simulation, _, _ = random_simulation(model, width)
    simulation.forward()
    simulation.bar.upload(terminal_weights())
    simulation.backward(layer)
    gradient = simulation.bar.download()
    state = simulation.layers[layer].download()
    control = simulation.transitions[layer].U.to_numpy()
    rng = np.random.default_rng(3)

    def difference(name: str, direction: Array) -> float:
        values = []
        step = 1e-5 if name != "x" else 1e-6
        for sign in (1.0, -1.0):
            moved = Particles(**{a: getattr(state, a).copy() for a in NAMES})
            shift = sign * step * direction
            if name == "U":
                simulation.transitions[layer].U.from_numpy(control + shift)
            else:
                setattr(moved, name, getattr(moved, name) + shift)
            simulation.layers[layer].upload(moved)
            values.append(loss(simulation, layer))
        simulation.transitions[layer].U.from_numpy(control)
        simulation.layers[layer].upload(state)
        return (values[0] - values[1]) / (2 * step)

    gradients = {a: getattr(gradient, a) for a in NAMES}
    gradients["U"] = simulation.transitions[layer].U_bar.to_numpy()
    for name, value in gradients.items():
        direction = value / np.linalg.norm(value) + 0.3 * rng.normal(size=value.shape) / np.sqrt(
            value.size
        )
        expected = difference(name, direction)
        assert np.sum(value * direction) == pytest.approx(expected, rel=1e-6), name


def test_published_adjoint_agrees_in_the_last_transition() -> None:
    """With no gradient by F and C at the end, both adjoints are equal there (algorithm 4.6)."""
    norms = []
    for flags in (AdjointConfig(), PUBLISHED):
        simulation, _, _ = random_simulation(FIXED_COROTATED, 4, flags)
        simulation.forward()
        weights = terminal_weights()
        zero = Particles(weights.x, 0 * weights.v, 0 * weights.C, 0 * weights.F)
        simulation.bar.upload(zero)
        simulation.backward()
        norms.append([np.linalg.norm(t.U_bar.to_numpy()) for t in simulation.transitions])
    exact, published = norms
    assert published[-1] == pytest.approx(exact[-1], rel=1e-12)
    assert published[0] != pytest.approx(exact[0], rel=0.05)
