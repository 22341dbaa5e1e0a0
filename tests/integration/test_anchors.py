"""The published program's numbers at the very start of sphere -> bunny (algorithm 13.2, 13.3)."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from morph_engine import backend
from morph_engine.losses.grid_mass import GridMass
from morph_engine.methods import Problem
from morph_engine.methods.physics import Physics
from morph_engine.metrics.chamfer import chamfer_metrics
from morph_engine.morphing import prepare
from morph_engine.mpm.grid import cell_order
from morph_engine.optimization import physics_weights
from morph_engine.presets import configure

DOCUMENT = Path(__file__).parents[2] / "docs" / "algorithm.md"

EXACT = dict.fromkeys(
    ("adjoint.drop_smoothing", "adjoint.carry_control", "adjoint.drop_drag"), False
)


@pytest.fixture
def problem(paper_mesh: Callable[[str], Path]) -> Callable[..., Problem]:
    """Makes the paper's sphere to bunny at its resolution, with settings of one's own."""

    def make(target: str = "bunny", **settings: Any) -> Problem:
        config = configure("published", {"method": "physics", **settings})
        record = prepare(paper_mesh("sphere"), paper_mesh(target), config)
        assert len(record.source_points) == 37644
        return Problem(record.source_points, record.target_points, config)

    return make


@pytest.fixture
def start(problem: Callable[..., Problem], float32_device: None) -> Physics:
    """The physics method before its first frame."""
    return Physics(problem(**{"optimizer.passes": 1}))


def begin(start: Physics) -> None:
    """Simulate the first frame without control, and take its losses."""
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


def documented(table: str, row: str) -> list[float]:
    """Numbers of a row of a table of the algorithm, under this heading."""
    text = DOCUMENT.read_text(encoding="utf-8").split(f"### {table} ")[1].split("\n### ")[0]
    (line,) = re.findall(rf"^\| {row} \|(.*)\|$", text, flags=re.MULTILINE)
    return [float(cell) for cell in line.split("|") if cell.strip()]


def test_rest_volumes(start: Physics) -> None:
    """Mean, extremes and total of the density estimate (algorithm 1.3), to its printed digits."""
    mass = 75 / 27
    device = backend.active()
    volumes = GridMass(37644, mass, start._grid).rest_volumes(device.upload(start.problem.source))
    assert volumes.mean() == pytest.approx(0.045472, abs=1e-6)
    assert volumes.min() == pytest.approx(0.0369, abs=1e-4)
    assert volumes.max() == pytest.approx(0.10414, abs=1e-5)
    assert volumes.sum(dtype=np.float64) == pytest.approx(1711.8, abs=0.1)


@pytest.mark.parametrize("target", ["bunny", "duck", "cow", "teapot"])
def test_undeformed_pairs(
    problem: Callable[..., Problem], float32_device: None, target: str
) -> None:
    """Loss and distances of algorithm 13.2, to their last digit."""
    start = Physics(problem(target))
    begin(start)
    found = chamfer_metrics(start.problem.source, start.problem.target, spacing=1 / 3)
    loss, *distances = documented("13.2", f"sphere, {target}")
    first = start._simulation.layers[0].x
    assert start._control._grid_loss.evaluate(first) == pytest.approx(loss, abs=0.1)
    names = ("s2t", "t2s", "two_sided", "hausdorff", "f1")
    assert [found[name] for name in names] == pytest.approx(distances, abs=6e-4)


def test_first_control_steps(start: Physics) -> None:
    """Losses, gradient norms and step lengths of the first five control steps.

    The reference values carry five to six digits; float32 and the order of sums change the sixth.
    """
    begin(start)
    simulation, control = start._simulation, start._control
    assert control._losses.physics == pytest.approx(5307.46, rel=1e-5)

    norms, steps, losses = [], [], []
    for layer in range(5):
        assert control._control_step([layer], 0)
        norms.append(control._norms([layer])[0])
        steps.append(np.linalg.norm(simulation.transitions[layer].U.to_numpy()))
        losses.append(control._losses.physics)
    np.testing.assert_allclose(norms, documented("13.3", "n_phys"), rtol=2e-5)
    np.testing.assert_allclose(steps, documented("13.3", "norm of the change of U"), rtol=3e-5)
    first, *rest = documented("13.3", "L_phys after the step")
    assert first == pytest.approx(5307.46, rel=1e-4)
    np.testing.assert_allclose(losses, rest, rtol=1e-4)


@pytest.mark.parametrize(("row", "settings"), [("published", {}), ("exact", EXACT)])
def test_gradient_norms_of_both_adjoints(
    problem: Callable[..., Problem], float32_device: None, row: str, settings: dict[str, Any]
) -> None:
    """Of all control layers at the start, as algorithm 4.6 has them from float64."""
    start = Physics(problem(**settings))
    begin(start)
    norms = start._control._physics_norms(list(range(9)))
    np.testing.assert_allclose(norms, documented("4.6", row), rtol=1e-4)
