"""Many parallel reads, each of which needs a child: how many there are, and who else waits.

The reads are surfaces of all frames of a job, asked for in turn; meanwhile comes what needs no
child.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import cycle
from time import sleep

import httpx

from benchmarks.hostile.extreme import finished
from benchmarks.service.children import ChildrenWatch
from benchmarks.service.fairness import timed
from benchmarks.service.local_service import LocalService, job_request, processes, submit
from benchmarks.service.measurement import Measurement, counted, percentile
from morph_engine.machine_memory import total_memory

COUNT = 200
FRAMES = 50
PAUSE_SECONDS = 0.1
UNLIMITED = httpx.Limits(max_connections=None)


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Compute a job, then read."""
    with service.served(1) as (api, supervisor):
        job = submit(api, job_request(FRAMES))
        assert finished(api, job)["state"] == "succeeded"
        (server,) = processes(supervisor, "chamfer_morph.server", "api")
        frames = cycle(range(FRAMES))
        paths = [f"/v1/jobs/{job}/frames/{next(frames)}/surface" for _ in range(count)]
        with (
            ThreadPoolExecutor(count) as pool,
            httpx.Client(base_url=api.base_url, timeout=None, limits=UNLIMITED) as other,
        ):
            for path in cheap_paths(job, 20):
                api.get(path).raise_for_status()
            with ChildrenWatch([server]) as watch:
                reads = [pool.submit(other.get, path) for path in paths]
                times = cheap_times(api, job, reads)
    answered = sum(read.result().is_success for read in reads)
    note = f"{len(times)} requests, median {percentile(times, 50):.3f} s"
    wanted = f"of {count}, of {FRAMES} surfaces"
    budget = total_memory() / 1e6
    return [
        Measurement("cheap endpoints, 99th percentile", percentile(times, 99), 0.5, "s", note),
        counted("children at a time", watch.most[0], service.settings.sandbox_processes),
        Measurement("memory of the children", watch.most[1] / 1e6, budget, "MB"),
        counted("reads that failed", count - answered, 0, wanted),
    ]


def cheap_paths(job: str, count: int) -> Iterator[str]:
    """Addresses that need no child."""
    kinds = cycle(["/v1/jobs", f"/v1/jobs/{job}", f"/v1/jobs/{job}/metrics", "/livez"])
    return (next(kinds) for _ in range(count))


def cheap_times(api: httpx.Client, job: str, reads: list[Future[httpx.Response]]) -> list[float]:
    """How long such addresses take while reads go on [s]."""
    times = []
    for path in cheap_paths(job, 10**6):
        if all(read.done() for read in reads):
            break
        times.append(timed(lambda path=path: api.get(path).raise_for_status()))
        sleep(PAUSE_SECONDS)
    return times
