"""Expected time and memory of a run, for reports and for refusing what cannot fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import BaseModel, Field

from morph_engine.machine_cores import usable_cores
from morph_engine.methods.registry import DEFAULT_METHOD, options_of

if TYPE_CHECKING:
    from morph_engine.results.run_record import RunRecord

BYTES_IN_RESULT = 16  # of a particle in a frame: position and det F
STARTUP_SECONDS = 4.0
MEGABYTES_AT_REST = 240.0
PARALLEL_EFFICIENCY = 0.9


class Estimate(BaseModel, frozen=True):
    """Expected cost of a run."""

    seconds: float = Field(ge=0, description="Wall-clock time of the whole run [s]")
    memory_mb: float = Field(ge=0, description="Peak resident memory [MB]")


def estimate(
    particle_count: int,
    target_count: int,
    frames: int,
    *,
    method: str = DEFAULT_METHOD,
    threads: int | None = None,
    nodes: int = 0,
) -> Estimate:
    """Estimate the cost of a run on the CPU by a model linear in particles, nodes and frames.

    Args:
        particle_count: Number of particles.
        target_count: Number of target points.
        frames: Number of frames.
        method: Name of the method.
        threads: Of the run; all of this machine's if not given.
        nodes: Of its grid, see `MethodOptions.node_count`.
    """
    workers = threads or usable_cores()
    rates = options_of(method).cost
    cpu_seconds = frames * (
        rates.seconds_per_frame
        + rates.seconds_per_particle * particle_count
        + rates.seconds_per_target * target_count
    )
    kilobytes = (
        rates.kilobytes_per_particle * particle_count + rates.kilobytes_per_target * target_count
    )
    return Estimate(
        seconds=STARTUP_SECONDS + cpu_seconds / max(1.0, PARALLEL_EFFICIENCY * workers),
        memory_mb=MEGABYTES_AT_REST + kilobytes / 1024 + rates.bytes_per_node * nodes / 1e6,
    )


def estimate_run(run: RunRecord, *, threads: int | None = None) -> Estimate:
    """Estimate the cost of a run whose shapes are known, of all its legs.

    Args:
        run: What it is made of.
        threads: CPU threads; all of this machine's if not given.
    """
    legs = [run.leg(k) for k in range(run.leg_count)]
    counts = [len(leg.target_points) for leg in legs]
    method = run.config.method
    return estimate(
        run.particle_count,
        max(counts),
        run.planned_frames,
        method=method.name,
        threads=threads,
        nodes=max(
            method.node_count(leg.config, radius=leg.radius, ratio=count / run.particle_count)
            for leg, count in zip(legs, counts, strict=True)
        ),
    )
