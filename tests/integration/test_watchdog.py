"""Trials and frames that must not stand (issue: no input may crash the process)."""

from __future__ import annotations

import numpy as np
import pytest

from morph_engine import backend
from morph_engine.errors import SimulationError
from morph_engine.methods import Problem
from morph_engine.methods.joint import Joint
from morph_engine.methods.physics import Physics
from morph_engine.presets import configure

pytestmark = pytest.mark.usefixtures("float32_device")


def block(center: float, count: int = 10) -> np.ndarray:
    """A cube of particles at half a grid unit."""
    axis = (np.arange(count) - (count - 1) / 2) * 0.5
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return (grid + np.array([center, 0, 0])).astype(np.float32)


def problem(method: str, **overrides: object) -> Problem:
    """A cube that is to move aside."""
    values = {"method": method, "sampling.points_per_cell_edge": 2, **overrides}
    return Problem(block(0.0), block(1.0), configure("fast", values))


def test_oversized_trials_are_rejected_and_halved() -> None:
    """Wild steps are refused with their cause on record, and the frame stays sound."""
    wild = {"optimizer.step": 40.0, "watchdog.cells_per_step": 0.05}
    method = Physics(problem("physics", **wild))
    outcome = method.advance(0)
    assert any(event.kind == "rejected" and event.data["count"] > 0 for event in outcome.events)
    assert np.isfinite(outcome.positions).all()
    assert outcome.deformation is not None and np.linalg.det(outcome.deformation).min() > 0


def test_a_frame_that_cannot_start_is_restarted_with_a_smaller_time_step() -> None:
    """A carried speed beyond the limit fails even without control; half the step passes."""
    method = Joint(problem("joint"))
    state = method.state()
    state["v"] = np.full_like(
        state["v"], [80.0, 0, 0]
    )  # 0.67 cells per step at the full time step, the limit is 0.5
    method.restore(state)
    outcome = method.advance(0)
    restarts = [event for event in outcome.events if event.kind == "restart"]
    assert len(restarts) == 1
    assert restarts[0].data["dt"] == pytest.approx(1 / 240)
    assert np.isfinite(outcome.positions).all()


def test_a_hopeless_frame_ends_the_run_and_keeps_the_state() -> None:
    """After all restarts the error names the cause, and the last good state stands."""
    method = Physics(problem("physics", **{"watchdog.restarts": 2}))
    state = method.state()
    state["v"] = np.full_like(state["v"], [1e4, 0, 0])
    method.restore(state)
    with pytest.raises(SimulationError, match="faster than the grid allows"):
        method.advance(0)
    np.testing.assert_array_equal(method.state()["v"], state["v"])


def test_the_device_is_the_one_asked_for() -> None:
    """Unknown devices are refused; the CPU is always there."""
    assert "cpu" in backend.available_devices()
    with pytest.raises(backend.DeviceError, match="no device called"):
        backend.start("abacus")  # type: ignore[arg-type]


def test_a_particle_that_no_time_step_keeps_is_left_outside() -> None:
    """The frame goes on at the full time step once smaller ones have failed, and says so."""
    method = Physics(problem("physics", **{"watchdog.restarts": 2}))
    with_one(method, place=15.9, speed=30.0)
    outcome = method.advance(0)
    assert [event.kind for event in outcome.events] == ["restart", "restart", "outside"]
    assert outcome.events[-1].data["count"] == 1
    assert 16 < outcome.positions[0, 0] < 18
    assert outcome.numbers["dt"] == pytest.approx(1 / 120)
    assert outcome.numbers["accepted_steps"] > 0


def test_a_lost_particle_stays_where_it_is() -> None:
    """Beyond the grid's reach it has no velocity, and no loss sees it (algorithm 2.1)."""
    method = Joint(problem("joint", **{"chamfer.weight": 0.0}))
    with_one(method, place=17.5, speed=5.0)
    outcomes = [method.advance(frame) for frame in range(2)]
    assert all(not outcome.events for outcome in outcomes)
    assert all(outcome.numbers["dt"] == pytest.approx(1 / 120) for outcome in outcomes)
    np.testing.assert_array_equal(outcomes[1].positions[0], [17.5, 0, 0])
    state = method.state()
    assert not state["v"][0].any()
    np.testing.assert_array_equal(state["F"][0], np.eye(3))
    assert abs(outcomes[1].positions[1:] - outcomes[0].positions[1:]).max() > 0.01


def test_a_margin_is_kept() -> None:
    """Where particles are to keep away from the walls, none is given up."""
    method = Physics(problem("physics", **{"watchdog.restarts": 2, "grid.margin": 0.05}))
    with_one(method, place=15.9, speed=30.0)
    with pytest.raises(SimulationError, match="left the domain"):
        method.advance(0)


def with_one(method: Physics | Joint, *, place: float, speed: float) -> None:
    """Put one particle of the cube at x = place, with a speed along x."""
    state = {name: values.copy() for name, values in method.state().items()}
    state["x"][0], state["v"][0] = [place, 0, 0], [speed, 0, 0]
    method.restore(state)
