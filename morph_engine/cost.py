"""Expected time and memory of a run, for reports and for refusing what cannot fit."""

from __future__ import annotations

import os
from typing import NamedTuple

from pydantic import BaseModel, Field

STARTUP_SECONDS = 8.0
MEGABYTES_AT_REST = 300.0
BYTES_IN_RESULT = 16  # of a particle in a frame: position and det F
PARALLEL_EFFICIENCY = 0.9


class Rates(NamedTuple):
    """What one point costs: CPU seconds per frame, and kilobytes; and a frame on the usual grid."""

    seconds_per_particle: float
    seconds_per_target: float
    kilobytes_per_particle: float
    kilobytes_per_target: float
    seconds_per_frame: float = 0.0


PHYSICS = Rates(40e-6, 4e-6, 5.2, 0.2)
POINTS = Rates(6e-6, 5e-6, 0.7, 0.3)  # at 30 steps per frame, as the rest below
RATES = {
    "dco": POINTS,
    "dcd": POINTS,
    "density_aware": Rates(9e-6, 6e-6, 0.8, 0.4),
    "shared_basis": Rates(20e-6, 5e-6, 1.3, 0.3),
    "transport": Rates(9e-6, 2e-6, 2.6, 0.2),
    "swd": Rates(160e-6, 6e-6, 3.0, 2.0),
    "sinkhorn": Rates(6e-6, 6e-6, 3.0, 2.0, seconds_per_frame=8.3),  # its work is on the nodes
}
"""Of single methods; every other method costs what `PHYSICS` says."""


class Estimate(BaseModel, frozen=True):
    """Expected cost of a run."""

    seconds: float = Field(ge=0, description="Wall-clock time of the whole run [s]")
    memory_mb: float = Field(ge=0, description="Peak resident memory [MB]")


def estimate(
    particle_count: int,
    target_count: int,
    frames: int,
    *,
    method: str = "transport",
    threads: int | None = None,
) -> Estimate:
    """Estimate the cost of a run on the CPU by a model linear in particles and frames.

    Args:
        particle_count: Particles of the source.
        target_count: Points of the target.
        frames: Frames to compute.
        method: Name of the method.
        threads: CPU threads to use; all of this machine by default.

    Returns:
        Expected wall-clock seconds and peak memory.
    """
    workers = threads or os.cpu_count() or 1
    rates = RATES.get(method, PHYSICS)
    cpu_seconds = frames * (
        rates.seconds_per_frame
        + rates.seconds_per_particle * particle_count
        + rates.seconds_per_target * target_count
    )
    kilobytes = (
        rates.kilobytes_per_particle * particle_count + rates.kilobytes_per_target * target_count
    )
    result_mb = BYTES_IN_RESULT * particle_count * frames / 1e6  # it is assembled in memory
    return Estimate(
        seconds=STARTUP_SECONDS + cpu_seconds / max(1.0, PARALLEL_EFFICIENCY * workers),
        memory_mb=MEGABYTES_AT_REST + kilobytes / 1024 + result_mb,
    )
