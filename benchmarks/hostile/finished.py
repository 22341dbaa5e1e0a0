"""A database of many finished jobs: what the janitor takes of memory, and submits of time.

All belong to one key, each has a folder with a file, and one has ended each second. They are copies
of the rows of one job that the queue itself has enqueued and finished.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import httpx
import sqlalchemy as sa

from benchmarks.service.fairness import smallest, timed
from benchmarks.service.local_service import (
    LocalService,
    job_request,
    peak_memory,
    processes,
    submit,
    wait_until,
)
from benchmarks.service.measurement import Measurement, percentile
from chamfer_morph.schemas import Outcome
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.retention.job_sizes import JobSizes
from chamfer_morph.worker.storage import Storage

COUNT = 100_000
OWNER = "ann"
RESULT_BYTES = 1000
BATCH = 1000
TIMES = ("created_at", "updated_at", "started_at_epoch_ms", "completed_at")
"""Columns in milliseconds since 1970."""

PAUSE_SECONDS = 0.2
SUBMITS = 200
SECONDS = 150.0
"""The janitor goes through finished jobs once a minute; this is more than two rounds."""


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Submit to an empty database; fill it; submit until the janitor has been through it twice."""
    header = service.add_key(OWNER, "submit")
    queue, storage = JobQueue(service.settings), Storage(service.data_dir)
    queue.migrate()
    engine = database(service.settings)
    sizes = JobSizes(engine, queue, storage)
    with service.served(0) as (api, _):
        api.headers.update(header)
        empty = [timed_submit(api) for _ in range(SUBMITS)]
    fill(queue, storage, count)
    full = []
    with service.served(0, retention_days=30) as (api, supervisor):
        api.headers.update(header)
        wait_until(lambda: processes(supervisor, "janitor"), "There is no janitor.")
        (janitor,) = processes(supervisor, "janitor")
        began = time.monotonic()
        while sizes.total() < count * RESULT_BYTES or time.monotonic() - began < SECONDS:
            full.append(timed_submit(api))
        memory = peak_memory(janitor)
        listing = [timed(lambda: api.get("/v1/jobs").raise_for_status()) for _ in range(20)]
    queue.close()
    engine.dispose()
    note = f"{count} finished jobs, {len(full)} submits, slowest {max(full):.2f} s"
    before = f"{len(empty)} submits, slowest {max(empty):.2f} s"
    return [
        Measurement("peak memory of the janitor", memory / 1e6, 150, "MB"),
        Measurement("submit, 99th percentile", percentile(full, 99), 0.2, "s", note),
        Measurement("submit, median", percentile(full, 50), None, "s"),
        Measurement("the same without them, p99", percentile(empty, 99), None, "s", before),
        Measurement("the same without them, median", percentile(empty, 50), None, "s"),
        Measurement("first page of the list, median", percentile(listing, 50), None, "s"),
    ]


def earlier(row: Mapping[str, Any], seconds: int) -> dict[str, Any]:
    """A row, so much earlier."""
    return {
        name: value - 1000 * seconds if name in TIMES and value is not None else value
        for name, value in row.items()
    }


def timed_submit(api: httpx.Client) -> float:
    """Submit a job after a pause; how long the answer takes [s]."""
    time.sleep(PAUSE_SECONDS)
    return timed(lambda: submit(api, job_request(frames=1)))


def fill(queue: JobQueue, storage: Storage, count: int) -> None:
    """Put finished jobs into database and folders."""
    first = new_id()
    queue.enqueue(smallest(), job_id=first, owner=OWNER, delay_seconds=3600)
    outcome = Outcome(
        sha256="0" * 64, size_bytes=RESULT_BYTES, frames=1, metrics={}, particle_count=1,
        target_count=1, cpu_seconds=0, peak_memory_mb=0,
    )  # fmt: skip
    assert queue.finish(first, outcome, {})
    with queue._workflows.begin() as connection:
        tables = (queue._workflows.table, queue._workflows.outcomes)
        patterns = [
            connection.execute(sa.select(table).where(table.c.workflow_uuid == first)).one()
            for table in tables
        ]
        ids = [first, *(new_id() for _ in range(count - 1))]
        for begin in range(1, count, BATCH):
            some = [*enumerate(ids[begin : begin + BATCH], begin)]
            for table, pattern in zip(tables, patterns, strict=True):
                rows = [
                    earlier(pattern._mapping, age) | {"workflow_uuid": job} for age, job in some
                ]
                connection.execute(sa.insert(table), rows)
    for job in ids:
        result = storage.result_path(job)
        result.parent.mkdir()
        with result.open("wb") as file:
            file.truncate(RESULT_BYTES)  # takes no block of the disk
