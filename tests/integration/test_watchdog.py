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
    state["v"][:] = [80.0, 0, 0]  # 0.67 cells per step at the full time step, the limit is 0.5
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
    state["v"][:] = [1e4, 0, 0]
    method.restore(state)
    with pytest.raises(SimulationError, match="faster than the grid allows"):
        method.advance(0)
    np.testing.assert_array_equal(method.state()["v"], state["v"])


def test_the_device_is_the_one_asked_for() -> None:
    """Unknown devices are refused; the CPU is always there."""
    assert "cpu" in backend.available_devices()
    with pytest.raises(backend.DeviceError, match="no device called"):
        backend.start("abacus")  # type: ignore[arg-type]
