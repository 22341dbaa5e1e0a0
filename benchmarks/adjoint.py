"""Rows on the backward step: its cost beside the forward step, and beside autodiff."""

from __future__ import annotations

import numpy as np

from benchmarks.agreement import require_agreement, require_equal_gradients
from benchmarks.comparison import Row, limit, speedup
from benchmarks.engine_step import EngineStep
from benchmarks.peers.taichi_autodiff import AutodiffSweep
from benchmarks.scene import SEED, ball
from benchmarks.timing import interleaved

STEP_COUNT = 2


def measure(quick: bool) -> list[Row]:
    """Measure the cost of the adjoint."""
    return [
        backward_to_forward(7 if quick else 21),
        against_autodiff(2 if quick else 5),
        against_autodiff(2 if quick else 5, by_rows=True),
    ]


def backward_to_forward(repeats: int) -> Row:
    """Cost of a backward step in forward steps."""
    scene = ball()
    ours = EngineStep(scene, STEP_COUNT)
    ours.hold(random_pull(scene.particle_count))
    costs = interleaved(
        {"forward": ours.advance, "backward": ours.sweep_back},
        repeats,
        before_each=ours.pull,
    )
    forward, backward = (
        1e9 * costs[name].cpu / scene.particle_count / STEP_COUNT
        for name in ("forward", "backward")
    )
    return limit(
        "backward step / forward step",
        backward,
        "CPU ns/particle",
        2.2,
        1.5,
        relative_to=forward,
    )


def against_autodiff(repeats: int, *, by_rows: bool = False) -> Row:
    """Forward and backward through a few steps, ours and Taichi's tape."""
    scene = ball()
    gradient = random_pull(scene.particle_count)
    ours = EngineStep(scene, STEP_COUNT)
    peer = AutodiffSweep(scene, gradient, STEP_COUNT, by_rows=by_rows)

    ours.hold(gradient)

    def forward_and_backward() -> None:
        ours.advance()
        ours.pull()
        ours.sweep_back()

    forward_and_backward()
    peer.advance()
    require_agreement(peer.name, peer.result(), ours.result())
    require_equal_gradients(peer.name, peer.control_gradients(), ours.control_gradients())

    costs = interleaved({"ours": forward_and_backward, "peer": peer.advance}, repeats)
    nanoseconds = {n: 1e9 * c.cpu / scene.particle_count / STEP_COUNT for n, c in costs.items()}
    return speedup(
        "forward + backward vs Taichi autodiff" + (", by rows" if by_rows else ""),
        nanoseconds["ours"],
        nanoseconds["peer"],
        "CPU ns/particle",
        None if by_rows else 20.0,
        None if by_rows else 40.0,
        f"{scene.particle_count} particles, {STEP_COUNT} steps; "
        f"wall ms {1e3 * costs['ours'].wall:.1f} and {1e3 * costs['peer'].wall:.1f}",
    )


def random_pull(particle_count: int) -> np.ndarray:
    """A gradient on the last positions, float32, shape [particle_count, 3]."""
    return np.random.default_rng(SEED).normal(size=(particle_count, 3)).astype(np.float32)
