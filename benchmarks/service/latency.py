"""How soon an idle worker starts a job, a watcher hears of an event, and all ends when told to.

Small jobs follow one another. Each has a watcher; an event's lag is the time from its line in the
log, which tells when it was written, to its arrival. Both ends read the clock of this machine.
"""

from __future__ import annotations

import json
import random
import time
from datetime import datetime
from statistics import median

import httpx

from benchmarks.service.local_service import (
    STOP_SECONDS,
    LocalService,
    job_document,
    job_request,
    submit,
)
from benchmarks.service.measurement import Measurement

JOBS = 15
FRAMES = 3


def measure(service: LocalService) -> list[Measurement]:
    """Submit, watch and wait, again and again."""
    starts, lags = [], []
    chance = random.Random(0)
    with service.served(workers=1) as (api, supervisor):
        watch(api, submit(api, job_request(FRAMES)))  # the kernels are compiled once
        for _ in range(JOBS):
            time.sleep(0.5 + chance.random())  # idle, and out of step with the worker's looks
            submitted = time.time()
            job = submit(api, job_request(FRAMES))
            lags += watch(api, job)
            shown = job_document(api, job)
            if shown["state"] != "succeeded":
                raise RuntimeError(f"{job} is {shown['state']}: {shown['problem']}")
            starts.append(seconds(shown["started_at"]) - submitted)
        told = time.monotonic()
        supervisor.terminate()
        supervisor.wait(STOP_SECONDS)
        stop = time.monotonic() - told
    return [
        median_of("submit to running", starts, 1),
        median_of("event to watcher", lags, 0.5),
        Measurement("told to end to ended", stop, 10, "s"),
    ]


def median_of(what: str, times: list[float], limit: float) -> Measurement:
    """The median of some times [s]."""
    return Measurement(
        what, median(times), limit, "s", f"{len(times)} times, at most {max(times):.2f}"
    )


def watch(api: httpx.Client, job: str) -> list[float]:
    """Watch a job to its end; returns the lag of each event that was written meanwhile [s]."""
    lags = []
    headers = {"Accept": "text/event-stream"}
    with api.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as stream:
        stream.raise_for_status()
        connected = time.time()
        for line in stream.iter_lines():
            if line.startswith("data:"):
                event = json.loads(line.removeprefix("data:"))
                written = seconds(event["at"])
                if event["type"] != "state" and written > connected:
                    lags.append(time.time() - written)
    return lags


def seconds(text: str) -> float:
    """A time of the API as seconds since 1970."""
    return datetime.fromisoformat(text.replace("Z", "+00:00")).timestamp()
