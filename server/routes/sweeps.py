"""/v1/sweeps: every combination of sources, targets, methods and seeds, and one table of it all."""

from __future__ import annotations

import math
from contextlib import ExitStack
from itertools import product
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Query, Response
from fastapi.openapi.models import Example

from chamfer_morph.schemas import JobRequest, JobState, Sweep, SweepRequest, SweepRow
from chamfer_morph.schemas.ids import is_id, new_id
from chamfer_morph.schemas.jobs import JobOptions
from chamfer_morph.server.auth import AuthenticatedRoute, Reader, Submitter
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.database.tables import SweepRow as StoredSweep
from chamfer_morph.server.database.tables import as_time
from chamfer_morph.server.http.csv_table import csv_table
from chamfer_morph.server.http.problems import ProblemError, not_found, unavailable
from chamfer_morph.server.routes.jobs import IdempotencyKey, accept
from chamfer_morph.server.submission import (
    idempotency_conflict,
    idempotent_id,
    prepare,
    request_digest,
    submit,
)
from chamfer_morph.worker.job_record import JobRecord
from chamfer_morph.worker.progress import read_progress
from morph_engine.config import overrides_of

router: APIRouter = APIRouter(prefix="/sweeps", tags=["sweeps"], route_class=AuthenticatedRoute)

JOBS = 1000
"""Most jobs of a sweep."""

EXAMPLES: dict[str, Example] = {
    "methods": {
        "summary": "Two methods on two targets",
        "value": {
            "sources": [{"shape": "sphere"}],
            "targets": [{"shape": "star"}, {"shape": "torus"}],
            "methods": ["joint", "physics"],
            "frames": 12,
        },
    }
}


@router.post(
    "",
    status_code=202,
    operation_id="submitSweep",
    summary="Submit a sweep",
    responses={
        200: {"model": Sweep, "description": "The sweep already made with this Idempotency-Key."}
    },
)
def submit_sweep(
    caller: Submitter,
    body: Annotated[SweepRequest, Body(openapi_examples=EXAMPLES)],
    response: Response,
    context: Context,
    idempotency_key: IdempotencyKey = None,
) -> Sweep:
    """Queue every combination of sources, targets, methods and seeds, at most 1000 jobs.

    Either all of them are queued or none. An override applies to the methods that have the
    setting; at least one of them must.

    If the service dies in the middle, the same request with the same Idempotency-Key adds the
    rest.
    """
    sweep, new = _submit(body, idempotency_key, caller, context)
    accept(response, f"/v1/sweeps/{sweep.id}", new=new)
    return sweep


@router.get(
    "/{sweep_id}",
    operation_id="getSweep",
    summary="Show a sweep",
    response_model=Sweep,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
def get_sweep(
    sweep_id: str,
    caller: Reader,
    context: Context,
    format: Annotated[Literal["json", "csv"], Query(description="Format of the table.")] = "json",
) -> Any:
    """The jobs of a sweep in one table, with the metrics of the last finished frame of each."""
    stored = context.sweeps.get(sweep_id) if is_id(sweep_id) else None
    if stored is None or not caller.can_see(stored.owner):
        raise not_found("sweep", sweep_id)
    sweep = _show(stored, context)
    if format == "csv":
        return Response(_table(sweep), media_type="text/csv; charset=utf-8")
    return sweep


def _submit(
    request: SweepRequest, key: str | None, caller: Caller, context: ServerContext
) -> tuple[Sweep, bool]:
    axes = request.sources, request.targets, request.methods, request.seeds
    count = math.prod(len(axis) for axis in axes)
    if count > JOBS:  # known before a single combination is made
        raise ProblemError(
            422, f"This sweep has {count} jobs, more than {JOBS}.", "Split it into several sweeps."
        )
    digest = request_digest(request)
    sweep_id = idempotent_id("sweep", caller, key) if key else new_id()
    known = context.sweeps.get(sweep_id)
    if known and known.body != digest:
        raise idempotency_conflict()
    ids = [idempotent_id(f"job {index}", caller, sweep_id) for index in range(count)]
    there = context.queue.states(ids)  # jobs may have been deleted since
    common = request.model_dump(include=JobOptions.model_fields.keys() - {"overrides"})
    missing = {
        job_id: prepare(
            JobRequest(
                source=source,
                target=target,
                method=method,
                seed=seed,
                overrides=overrides_of(method, request.overrides, request.methods),
                **common,
            ),
            caller,
            context,
        )
        for job_id, (source, target, method, seed) in zip(ids, product(*axes), strict=True)
        if job_id not in there
    }
    needed = sum(submission.disk_bytes for submission in missing.values())
    letting_in = context.quotas.letting_in_jobs(caller.name, len(missing), needed_bytes=needed)
    with ExitStack() as stack:
        alone = stack.enter_context(context.quotas.submitting_sweep(sweep_id))
        try:
            queued = stack.enter_context(letting_in)
        except ProblemError as refusal:
            if alone:
                raise
            words = "The jobs of this sweep are being queued by an earlier request."
            raise unavailable(words) from refusal
        stored, new = context.sweeps.add(sweep_id, caller.name, request.name, digest)
        if stored.body != digest:
            raise idempotency_conflict()
        for job_id, submission in missing.items():
            submit(submission, job_id=job_id, caller=caller, context=context, sweep=sweep_id)
            queued()
    return _show(stored, context), new


def _show(stored: StoredSweep, context: ServerContext) -> Sweep:
    records = context.queue.newest(sweep=stored.id, limit=JOBS)
    counts = dict.fromkeys(JobState, 0)
    for record in records:
        counts[record.state] += 1
    return Sweep(
        id=stored.id,
        name=stored.name,
        created_at=as_time(stored.created_at),
        counts=counts,
        rows=sorted((_row(record, context) for record in records), key=_order),
    )


def _row(record: JobRecord, context: ServerContext) -> SweepRow:
    if record.outcome is not None:
        metrics = record.outcome.metrics
    else:
        metrics = read_progress(context.storage, record.id, record.spec).metrics
    return SweepRow(
        job=record.id,
        source=str(record.attributes.get("source_name", "")),
        target=str(record.attributes.get("target_name", "")),
        method=record.spec.config.method.name,
        seed=record.spec.config.seed,
        state=record.state,
        metrics=metrics,
    )


def _order(row: SweepRow) -> tuple[str, str, str, int]:
    return row.source, row.target, row.method, row.seed


def _table(sweep: Sweep) -> str:
    names = list(dict.fromkeys(name for row in sweep.rows for name in row.metrics))
    plain = ["job", "source", "target", "method", "seed", "state"]
    rows = (
        [row.job, row.source, row.target, row.method, row.seed, row.state.value]
        + [row.metrics.get(name, "") for name in names]
        for row in sweep.rows
    )
    return csv_table([*plain, *names], rows)
