"""Jobs at the ends of what may be asked for: the memory expected of each against what it took.

The service tells what it expects of a job when it refuses it, so that one which lets jobs have
nothing is asked first. Then a worker computes a frame of each, in a process of its own, whose
memory is looked at; a job is stopped after `LONGEST_SECONDS`, and counts if it has taken more than
expected by then. What the service refuses for what this machine has is skipped.
"""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from itertools import product
from typing import Any

import httpx
import psutil

from benchmarks.service.local_service import (
    LocalService,
    job_document,
    peak_memory,
    processes,
    submit,
    wait_until,
)
from benchmarks.service.measurement import Measurement, counted

COUNT = 30
LONGEST_SECONDS = 300.0
JOB_MEMORY_BYTES = 8 << 30
EXPECTED = re.compile(r"needs about ([\d,]+) MB")

GRIDS: tuple[dict[str, Any], ...] = (
    {"grid.half_extent": 120, "sampling.points_per_cell_edge": 1},
    {"grid.dx": 0.2, "time.dt": 0.0005, "sampling.points_per_cell_edge": 1},
    {"grid.dx": 0.128, "time.dt": 0.0003, "sampling.points_per_cell_edge": 1},
    {"grid.dx": 8, "sampling.points_per_cell_edge": 4},
    {"sampling.points_per_cell_edge": 5},
)
"""Shapes in the middle of 240 cells; 160, 250 and 4 cells for each axis; many particles."""

POINTS: tuple[dict[str, Any], ...] = (
    {"sampling.points_per_cell_edge": 1},
    {"sampling.points_per_cell_edge": 4},
)
EXTREMES: tuple[tuple[dict[str, Any], str], ...] = (
    *product(GRIDS, ("flow", "joint", "physics", "transport")),
    *product(POINTS, ("dcd", "dco", "shared_basis", "swd", "sinkhorn")),
)


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Ask what is expected, compute, and compare."""
    requests = [request(*extreme) for extreme in EXTREMES[:count]]
    with service.served(0, job_memory_bytes=1) as (api, _):
        expected = [expected_megabytes(api, each) for each in requests]
    ratios, killed, refused, unfinished = [], 0, 0, 0
    with service.served(
        1,
        job_memory_bytes=JOB_MEMORY_BYTES,
        job_timeout_seconds=LONGEST_SECONDS,
        attempts=1,
        warm_engines=False,
    ) as (api, supervisor):
        for each, megabytes in zip(requests, expected, strict=True):
            if megabytes is None or megabytes > JOB_MEMORY_BYTES / 1e6:
                refused += api.post("/v1/jobs", json=each).status_code == 422
                continue
            wait_until(lambda: not engines(supervisor), "An engine does not end.")
            job, taken = computed(api, supervisor, submit(api, each))
            problem = job["problem"]
            killed += problem is not None and "memory" in problem["cause"]
            unfinished += problem is not None
            if problem is None or taken > megabytes:  # else it may have been to take more
                ratios.append(taken / megabytes)
            tell(each, megabytes, taken, job)
    note = f"{len(ratios)} jobs; taken over expected from {min(ratios):.2f} to {max(ratios):.2f}"
    if not ratios:
        sys.exit("None of the jobs has ended.")
    return [
        Measurement("expected against taken", max(max(r, 1 / r) for r in ratios), 2, "", note),
        counted("killed for memory", killed, 0),
        Measurement("refused", refused, None, "", "more than jobs may have, or not possible"),
        Measurement("without an end or failed", unfinished, None, ""),
    ]


def request(overrides: dict[str, Any], method: str) -> dict[str, Any]:
    """A job of one frame."""
    return {
        "method": method,
        "source": {"shape": "sphere"},
        "target": {"shape": "star"},
        "overrides": overrides,
        "frames": 1,
        "device": "cpu",
    }


def expected_megabytes(api: httpx.Client, request: dict[str, Any]) -> float | None:
    """What a service without memory for jobs expects of one [MB]; None for an impossible one."""
    answer = api.post("/v1/jobs", json=request)
    assert answer.status_code == 422, answer.text
    found = EXPECTED.search(answer.json()["detail"])
    return float(found[1].replace(",", "")) if found else None


def computed(
    api: httpx.Client, supervisor: psutil.Process, job: str
) -> tuple[dict[str, Any], float]:
    """A job that has ended, once it has, and the most memory that its engine took [MB]."""
    taken = 0

    def ended() -> bool:
        nonlocal taken
        for engine in engines(supervisor):
            with suppress(OSError, IndexError):  # it has ended, or just now
                taken = max(taken, peak_memory(engine))
        return job_document(api, job)["state"] not in ("queued", "running")

    wait_until(ended, f"{job} does not end.")
    return job_document(api, job), taken / 1e6


def engines(supervisor: psutil.Process) -> list[psutil.Process]:
    """The engine processes of a service."""
    return processes(supervisor, "chamfer_morph.worker.engine_process")


def finished(api: httpx.Client, job: str) -> dict[str, Any]:
    """A job that has ended, once it has."""
    wait_until(
        lambda: job_document(api, job)["state"] not in ("queued", "running"),
        f"{job} does not end.",
    )
    return job_document(api, job)


def tell(request: dict[str, Any], expected: float, taken: float, job: dict[str, Any]) -> None:
    """A line for each job; both memories in MB."""
    settings = ", ".join(f"{name} {value}" for name, value in request["overrides"].items())
    end = f" {job['problem']['cause']}" if job["problem"] else ""
    memory = f"{expected:.0f} MB expected, {taken:.0f} MB taken"
    sys.stderr.write(f"{request['method']}, {settings}: {memory}.{end}\n")
