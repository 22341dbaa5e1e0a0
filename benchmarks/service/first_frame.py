"""How long a user waits for the first computed frame of a default job, and for all of it.

Jobs of 38k particles follow one another, each when the service is idle. For every second one the
service has forgotten what it kept of the shapes, but not the compiled kernels.
"""

from __future__ import annotations

import json
import shutil
import time
from contextlib import suppress
from statistics import median
from typing import Any

import httpx
import psutil

from benchmarks.service.latency import seconds
from benchmarks.service.local_service import LocalService, job_document, processes, submit
from benchmarks.service.measurement import Measurement, percentile
from chamfer_morph.worker.storage import Storage

JOBS = 10
REQUEST = {"source": {"shape": "sphere"}, "target": {"shape": "star"}}
"""A job with default settings; it has 40 frames."""

WHOLE = (-1, 0, 2, 4)
"""Turns in which a job may end; the first one's process stores the kernels that it compiled."""

QUIET_SECONDS = 1.5
"""An engine process that has slept for so long waits for a job."""


def measure(service: LocalService) -> list[Measurement]:
    """Submit, wait for the first frame, then for the end and for rest."""
    known, new, whole = [], [], []
    with service.served(workers=1, threads=0) as (api, supervisor):
        for turn in range(-1, 2 * JOBS):
            wait_until_idle(supervisor)
            if turn % 2:
                kept = Storage(service.data_dir).kept_results
                shutil.rmtree(kept, ignore_errors=True)
            submitted = time.time()
            job = submit(api, REQUEST)
            first = first_frame(api, job) - submitted
            if turn >= 0:  # kernels were compiled before
                (new if turn % 2 else known).append(first)
            if turn in WHOLE:
                end = seconds(finished(api, job)["finished_at"]) - submitted
                whole += [end] if turn >= 0 else []
            else:
                api.post(f"/v1/jobs/{job}/cancel").raise_for_status()
    return [
        *spread("submit to first frame, known shapes", known, (0.8, 1.2)),
        *spread("submit to first frame, new shapes", new, (None, None)),
        Measurement("submit to the end, 40 frames", median(whole), 6.0, "s", f"{len(whole)} times"),
    ]


def spread(
    what: str, times: list[float], limits: tuple[float | None, float | None]
) -> list[Measurement]:
    """The median and the 95th percentile of some times [s]."""
    note = f"{len(times)} times, from {min(times):.2f} to {max(times):.2f}"
    return [
        Measurement(f"{what}: median", median(times), limits[0], "s", note),
        Measurement(f"{what}: p95", percentile(times, 95), limits[1], "s"),
    ]


def first_frame(api: httpx.Client, job: str) -> float:
    """When a watcher hears of the first frame of a job [s since 1970]."""
    headers = {"Accept": "text/event-stream"}
    with api.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as stream:
        stream.raise_for_status()
        for line in stream.iter_lines():
            if line.startswith("data:"):
                event = json.loads(line.removeprefix("data:"))
                if event["type"] == "frame":
                    return time.time()
    raise RuntimeError(f"{job} ended without a frame")


def finished(api: httpx.Client, job: str) -> dict[str, Any]:
    """A job that has succeeded, once it has."""
    while True:
        shown = job_document(api, job)
        if shown["state"] == "succeeded":
            return shown
        if shown["state"] not in ("queued", "running"):
            raise RuntimeError(f"{job} is {shown['state']}: {shown['problem']}")
        time.sleep(0.1)


def wait_until_idle(supervisor: psutil.Process, workers: int = 1) -> None:
    """Wait until the service has nothing to do: its next engine processes are ready, too."""
    busy = time.monotonic()
    while time.monotonic() - busy < QUIET_SECONDS:
        time.sleep(0.05)
        states = engine_states(supervisor)
        if states != [psutil.STATUS_SLEEPING] * workers:
            busy = time.monotonic()


def engine_states(supervisor: psutil.Process) -> list[str]:
    """What the engine processes of a service do: run, sleep and so on."""
    states = []
    for process in processes(supervisor, "chamfer_morph.worker.engine_process"):
        with suppress(psutil.Error):  # it has ended
            states.append(process.status())
    return states
