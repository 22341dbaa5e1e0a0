"""Rows on size: whole default jobs of 11 thousand to 700 thousand particles, each in a process."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import mean
from tempfile import TemporaryDirectory

from benchmarks.comparison import Row, limit
from morph_engine import spans
from morph_engine.cost import estimate_run
from morph_engine.morphing import prepare, run
from morph_engine.peak_memory import peak_memory
from morph_engine.presets import configure

POINTS_PER_CELL_EDGE = (2, 3, 4, 8)
GIGABYTE = 1e9


@dataclass(frozen=True)
class Job:
    """What a job took.

    Attributes:
        particles: Their number.
        whole: Wall-clock time of all of it but imports [s].
        filling: That of filling both shapes with particles [s].
        measuring: That of the metrics of the last frame, which has the most [s].
        frame: Mean of its frames but the first, which loads kernels [s].
        particle: CPU time of a particle in such a frame [us].
        memory: Peak resident memory [GB].
        expected: What the estimate says before [GB].
    """

    particles: int
    whole: float
    filling: float
    measuring: float
    frame: float
    particle: float
    memory: float
    expected: float


class Stopwatch:
    """Adds up how long spans take, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._open: list[tuple[str, float]] = []

    def begin(self, name: str, attributes: Mapping[str, int]) -> None:
        """A span begins."""
        self._open.append((name, time.perf_counter()))

    def end(self) -> None:
        """The last one ends."""
        name, began = self._open.pop()
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began


def measure(quick: bool) -> list[Row]:
    """Run the jobs; the largest only in the full benchmark, where it takes some minutes."""
    jobs = []
    for points in POINTS_PER_CELL_EDGE[:-1] if quick else POINTS_PER_CELL_EDGE:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            jobs.append(pool.submit(computed, points).result())
    costs = [job.particle for job in jobs]
    usual, largest = jobs[1], jobs[-1]
    off = max(abs(job.expected / job.memory - 1) for job in jobs)
    rows = [
        limit(
            f"dearest particle over the cheapest, {_thousands(jobs[0])} to {_thousands(largest)}",
            max(costs),
            "CPU us a frame",
            1.3,
            1.1,
            ", ".join(f"{_thousands(job)}: {job.particle:.2f}" for job in jobs),
            relative_to=min(costs),
        ),
        limit(f"memory, {_thousands(usual)} particles", usual.memory, "GB", 0.4, 0.3),
        limit("memory: estimate off by, at most", off, "", 0.25, 0.1),
    ]
    if quick:
        return rows
    name = f"{_thousands(largest)} particles"
    return [
        *rows,
        limit(f"{name}: frame", largest.frame, "s", 2.5, 1.25),
        limit(f"{name}: metrics of the last frame", largest.measuring, "s", 0.5, 0.25),
        limit(f"{name}: filling", largest.filling, "s", 5.0, 2.5),
        limit(f"{name}: whole job, 40 frames", largest.whole, "s", 240.0, 120.0),
        limit(f"memory, {name}", largest.memory, "GB", 2.0, 1.2),
    ]


def computed(points: int) -> Job:
    """Compute a job of 40 frames, in the only process that does."""
    stopwatch = Stopwatch()
    spans.listen(stopwatch)
    config = configure(overrides={"sampling.points_per_cell_edge": points})
    began = time.perf_counter()
    record = prepare("sphere", "torus", config)
    with TemporaryDirectory() as folder:
        frames = list(
            (frame.seconds, frame.cpu_seconds)
            for frame in run(record, device="cpu", out=Path(folder) / "job.vtkhdf")
        )
    whole = time.perf_counter() - began
    between = frames[1:-1]
    return Job(
        particles=record.particle_count,
        whole=whole,
        filling=stopwatch.seconds["filling"],
        measuring=stopwatch.seconds["measuring"],
        frame=mean(wall for wall, _ in between),
        particle=1e6 * mean(cpu for _, cpu in between) / record.particle_count,
        memory=peak_memory() / GIGABYTE,
        expected=estimate_run(record).memory_mb / 1000,
    )


def _thousands(job: Job) -> str:
    return f"{job.particles / 1000:.0f}k"
