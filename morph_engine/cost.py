"""Expected time and memory of a run, for reports and for refusing what cannot fit."""

from __future__ import annotations

import os

from pydantic import BaseModel, ConfigDict, Field

CPU_SECONDS_PER_PARTICLE_FRAME = 40e-6
CPU_SECONDS_PER_TARGET_FRAME = 4e-6
STARTUP_SECONDS = 8.0
MEGABYTES_AT_REST = 300.0
KILOBYTES_PER_PARTICLE = 5.2
KILOBYTES_PER_TARGET = 0.2
PARALLEL_EFFICIENCY = 0.9


class Estimate(BaseModel):
    """Expected cost of a run."""

    model_config = ConfigDict(frozen=True)

    seconds: float = Field(ge=0, description="Wall-clock time of the whole run [s]")
    memory_mb: float = Field(ge=0, description="Peak resident memory [MB]")


def estimate(
    particle_count: int, target_count: int, frames: int, *, threads: int | None = None
) -> Estimate:
    """Estimate the cost of a run on the CPU by a model linear in particles and frames.

    Args:
        particle_count: Particles of the source.
        target_count: Points of the target.
        frames: Frames to compute.
        threads: CPU threads to use; all of this machine by default.

    Returns:
        Expected wall-clock seconds and peak memory.
    """
    workers = threads or os.cpu_count() or 1
    cpu_seconds = frames * (
        CPU_SECONDS_PER_PARTICLE_FRAME * particle_count
        + CPU_SECONDS_PER_TARGET_FRAME * target_count
    )
    kilobytes = KILOBYTES_PER_PARTICLE * particle_count + KILOBYTES_PER_TARGET * target_count
    return Estimate(
        seconds=STARTUP_SECONDS + cpu_seconds / max(1.0, PARALLEL_EFFICIENCY * workers),
        memory_mb=MEGABYTES_AT_REST + kilobytes / 1024,
    )
