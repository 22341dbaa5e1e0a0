"""Jobs that equal one which has succeeded, answered with its result: the same code, the same bits.

Equal are shapes, all settings and the device; and the code that shapes such runs is still the one
that has computed the result.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from contextlib import suppress
from pathlib import Path

from chamfer_morph.worker.job import JobSpec
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.queue import JobQueue
from chamfer_morph.worker.storage import OwnershipLostError, Storage, StoreUnavailableError
from morph_engine.code_digest import code_digest

EVENTS = "events.jsonl"

TAKEOVER_SECONDS = 60.0
"""A job waits so long for its result; if the API dies within them, it is computed then."""


def run_digest(spec: JobSpec) -> str:
    """What tells two runs apart, as one SHA-256; how long they may take is no part of it."""
    exclude = {"timeout_seconds", "states_every"} | (set() if spec.fork else {"fork"})
    return hashlib.sha256(spec.model_dump_json(exclude=exclude).encode()).hexdigest()


def find_equal(spec: JobSpec, owner: str, queue: JobQueue, storage: Storage) -> JobRecord | None:
    """The newest job of an owner that has succeeded with this very run, if its result is there."""
    code = code_digest(spec.config.method.name)
    for record in queue.succeeded(owner, run_digest(spec)):
        outcome = record.outcome
        if outcome is None or outcome.provenance.get("code") != code:
            continue
        with suppress(OSError, StoreUnavailableError):
            storage.fetch(record.id, record.finished_at)
            if storage.result_path(record.id).stat().st_size == outcome.size_bytes:
                return record
    return None


def take_over(equal: JobRecord, job_id: str, queue: JobQueue, storage: Storage) -> None:
    """Give a job that waits for it the result of an equal one.

    Where that has just gone, the job is computed.
    """
    source, target = storage.job_dir(equal.id), storage.job_dir(job_id)
    assert equal.outcome is not None
    try:
        storage.claim(job_id, 0)
        shutil.copyfile(source / EVENTS, target / EVENTS)  # a log that goes on is written in place
        _link(storage.result_path(equal.id), storage.result_path(job_id))
        storage.publish(job_id)
    except (OSError, OwnershipLostError, StoreUnavailableError):
        with suppress(StoreUnavailableError):
            storage.remove_job(job_id)
    else:
        first = equal.reused_from or equal.id
        queue.finish(job_id, equal.outcome, {"reused_from": first})


def _link(source: Path, target: Path) -> None:
    """One file under two names, or a copy where the file system cannot; it is never written to."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
