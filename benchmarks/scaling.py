"""Row on scaling: cost per particle of a step and its adjoint over the number of particles."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.adjoint import random_pull
from benchmarks.comparison import Row, limit
from benchmarks.engine_step import EngineStep
from benchmarks.scene import ball
from benchmarks.timing import interleaved

POINTS_PER_CELL_EDGE = (2, 3, 4, 5, 6)


def measure(quick: bool) -> list[Row]:
    """Compare the dearest particle with the cheapest, from 11 to 301 thousand particles."""
    counts, actions = {}, {}
    scenes = [ball(points) for points in POINTS_PER_CELL_EDGE]
    most = max(scene.particle_count for scene in scenes)
    for scene in scenes:
        name = f"{scene.particle_count / 1000:.0f}k"
        # steps follow each other as in a run: the same work in every turn, with warm caches
        steps = round(most / scene.particle_count)
        counts[name] = steps * scene.particle_count
        actions[name] = forward_and_backward(EngineStep(scene), scene.particle_count, steps)
    costs = interleaved(actions, 3 if quick else 11)
    nanoseconds = {name: 1e9 * costs[name].cpu / count for name, count in counts.items()}
    return [
        limit(
            "cost per particle, 11k to 301k particles, dearest / cheapest",
            max(nanoseconds.values()),
            "CPU ns/particle",
            1.3,
            1.1,
            ", ".join(f"{name} {value:.0f}" for name, value in nanoseconds.items()),
            relative_to=min(nanoseconds.values()),
        )
    ]


def forward_and_backward(engine: EngineStep, particle_count: int, steps: int) -> Callable[[], None]:
    """Steps forward and back, again and again."""
    engine.hold(random_pull(particle_count))

    def action() -> None:
        for _ in range(steps):
            engine.advance()
            engine.pull()
            engine.sweep_back()

    return action
