"""The published program's numbers at the very start of sphere -> bunny (algorithm 13.2, 13.3)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from morph_engine import backend
from morph_engine.losses.grid_mass import GridMass
from morph_engine.methods import Problem
from morph_engine.methods.physics import Physics
from morph_engine.morphing import prepare
from morph_engine.mpm.grid import cell_order
from morph_engine.optimization import physics_weights
from morph_engine.presets import configure


@pytest.fixture
def start(paper_mesh: Callable[[str], Path], float32_device: None) -> Physics:
    """The physics method before its first frame, at the resolution of the paper."""
    record = prepare(
        paper_mesh("sphere"), paper_mesh("bunny"), configure("published", {"method": "physics"})
    )
    assert len(record.source_points) == 37644
    assert len(record.target_points) in (31428, 31429)
    config = configure("published", {"method": "physics", "optimizer.passes": 1})
    return Physics(Problem(record.source_points, record.target_points, config))


def test_rest_volumes(start: Physics) -> None:
    """Mean, extremes and total of the density estimate (algorithm 1.3), to its printed digits."""
    mass = 75 / 27
    device = backend.active()
    volumes = GridMass(37644, mass, start._grid).rest_volumes(device.upload(start.problem.source))
    assert volumes.mean() == pytest.approx(0.045472, abs=1e-6)
    assert volumes.min() == pytest.approx(0.0369, abs=1e-4)
    assert volumes.max() == pytest.approx(0.10414, abs=1e-5)
    assert volumes.sum(dtype=np.float64) == pytest.approx(1711.8, abs=0.1)


def test_first_control_steps(start: Physics) -> None:
    """Losses, gradient norms and step lengths of the first five control steps.

    The reference values carry five to six digits; float32 and the order of sums change the sixth.
    """
    simulation, control = start._simulation, start._control
    order = cell_order(start._particles.x, start._grid)
    simulation.volume.from_numpy(start._rest_volume[order])
    simulation.layers[0].upload(start._particles.permuted(order))
    weights = physics_weights(start.options.smoothing, 0)
    simulation.smoothing = weights.smoothing
    control._weights = weights
    control._reset()
    simulation.forward()
    control._losses = control._evaluate()
    assert control._losses.physics == pytest.approx(5307.46, rel=1e-5)

    norms, steps, losses = [], [], []
    for layer in range(5):
        assert control._control_step([layer], 0)
        norms.append(control._norms([layer])[0])
        steps.append(np.linalg.norm(simulation.transitions[layer].U.to_numpy()))
        losses.append(control._losses.physics)
    np.testing.assert_allclose(norms, [110.208, 99.389, 89.746, 80.208, 69.728], rtol=2e-5)
    np.testing.assert_allclose(steps, [2.64871, 1.68499, 1.29895, 1.08141, 0.93622], rtol=2e-5)
    np.testing.assert_allclose(
        losses, [5242.040, 5201.657, 5171.836, 5148.710, 5130.864], rtol=1e-4
    )
