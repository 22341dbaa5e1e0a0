"""How many queued jobs of 11k particles two workers finish a minute, and what CPU time they take.

All jobs are default ones but for their fineness, of shapes that the service has seen before. Each
is computed by a process of its own, whose start counts.
"""

from __future__ import annotations

import time
from contextlib import suppress

import psutil

from benchmarks.service.first_frame import finished, wait_until_idle
from benchmarks.service.local_service import LocalService, submit
from benchmarks.service.measurement import Measurement

JOBS = 40
WORKERS = 2
REQUEST = {
    "source": {"shape": "sphere"},
    "target": {"shape": "star"},
    "overrides": {"sampling.points_per_cell_edge": 2},
}
"""11 000 particles and 40 frames."""


def measure(service: LocalService) -> list[Measurement]:
    """Queue jobs when the service is warm, and wait for the last."""
    with service.served(workers=WORKERS, threads=0) as (api, supervisor):
        for job in [submit(api, REQUEST) for _ in range(WORKERS)]:  # kernels are compiled
            finished(api, job)
        wait_until_idle(supervisor, WORKERS)
        before = cpu_seconds_of_all(supervisor)
        begun = time.monotonic()
        for job in [submit(api, REQUEST) for _ in range(JOBS)]:
            finished(api, job)
        wall = time.monotonic() - begun
        wait_until_idle(supervisor, WORKERS)  # as many processes were started as jobs finished
        cpu = cpu_seconds_of_all(supervisor) - before
    what, note = "queued jobs of 11k particles", f"{JOBS} jobs in {wall:.0f} s"
    return [
        Measurement(what, 60 * JOBS / wall, None, "a minute", note),
        Measurement(
            f"{what}: CPU time of each, with all of the service", cpu / JOBS, None, "CPU s"
        ),
    ]


def cpu_seconds_of_all(supervisor: psutil.Process) -> float:
    """CPU time of a service so far [s], with that of its processes that have ended."""
    total = 0.0
    for process in (supervisor, *supervisor.children(recursive=True)):
        with suppress(psutil.Error):  # it has ended
            total += sum(process.cpu_times()[:4])
    return total
