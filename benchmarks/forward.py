"""Rows on the forward step: P2G, grid, G2P; cubic spline, neo-Hookean, 37 thousand particles."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from benchmarks.agreement import require_agreement
from benchmarks.comparison import Row, skipped, speedup
from benchmarks.engine_step import EngineStep
from benchmarks.peers import PeerMissingError, Stepper
from benchmarks.peers.numpy_step import NumpyStep
from benchmarks.scene import ball
from benchmarks.timing import interleaved

# what, module and class of the peer, at least, aim
PEERS = (
    ("forward step vs NVIDIA Warp CPU", "warp_step", "WarpStep", 1.5, 2.0),
    ("forward step vs plain C++", "cpp_step", "CppStep", 1.4, 2.0),
    ("forward step vs C++ vectorised by hand", "cpp_step", "CppFloat4Step", None, None),
    ("forward step vs NumPy float64", "numpy_whole_array", "NumpyWholeArray", 50.0, 100.0),
    ("forward step vs NumPy float64, tuned", "numpy_step", "NumpyStep", None, None),
)

STEP_COUNT = 9
"""Steps a turn, as many as a frame has: they follow each other as in a run."""


def measure(quick: bool) -> list[Row]:
    """Time ours and every peer in turns and compare CPU time per particle."""
    scene = ball()
    reference = NumpyStep(scene)
    reference.advance()
    steppers: dict[str, Stepper] = {EngineStep.name: EngineStep(scene)}
    missing: dict[str, str] = {}
    for what, module, class_name, *_ in PEERS:
        try:
            steppers[what] = getattr(import_module(f"benchmarks.peers.{module}"), class_name)(scene)
        except PeerMissingError as error:
            missing[what] = str(error)
    for name, stepper in steppers.items():
        stepper.advance()
        require_agreement(name, stepper.result(), reference.result())

    costs = interleaved({name: steps(s) for name, s in steppers.items()}, 3 if quick else 9)
    ours = costs[EngineStep.name]
    per_particle = 1e9 / (scene.particle_count * STEP_COUNT)
    return [
        skipped(what, missing[what])
        if what in missing
        else speedup(
            what,
            ours.cpu * per_particle,
            costs[what].cpu * per_particle,
            "CPU ns/particle",
            at_least,
            aim,
            f"wall ms {1e3 * ours.wall / STEP_COUNT:.1f} and "
            f"{1e3 * costs[what].wall / STEP_COUNT:.1f}",
        )
        for what, _, _, at_least, aim in PEERS
    ]


def steps(stepper: Stepper) -> Callable[[], None]:
    """Some steps, one after another."""

    def action() -> None:
        for _ in range(STEP_COUNT):
            stepper.advance()

    return action
