"""Jobs and sweeps as tables on standard output."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from datetime import datetime

from chamfer_morph.cli.tables import HEADLINE, clock, losses, print_metrics, print_table, size
from chamfer_morph.schemas import Job, Sweep


def print_jobs(jobs: Iterable[Job]) -> None:
    """A line a job."""
    print_table(
        ("job", "state", "frames", "morph", "method", "submitted", "name"),
        (
            (
                job.id,
                job.state.value,
                f"{job.progress.frame}/{job.progress.frames}",
                f"{job.source_name} to {job.target_name}",
                job.method,
                moment(job.created_at),
                job.name,
            )
            for job in jobs
        ),
    )


def print_job(job: Job) -> None:
    """Everything about a job."""
    rows = [
        ("state", _state(job)),
        ("morph", f"{job.source_name} to {job.target_name}"),
        ("method, preset, seed", f"{job.method}, {job.preset}, {job.seed}"),
        ("device, priority", f"{job.device}, {job.priority}"),
        ("frames", f"{job.progress.frame} of {job.progress.frames}"),
        ("metrics", losses(job.progress.metrics)),
        (
            "time left",
            "" if job.progress.seconds_left is None else clock(job.progress.seconds_left),
        ),
        ("submitted", moment(job.created_at)),
        ("started", moment(job.started_at)),
        ("finished", moment(job.finished_at)),
        ("attempt", str(job.progress.attempt or "")),
        ("name", job.name),
        ("owner", job.owner),
        ("sweep", job.sweep or ""),
    ]
    if job.outcome:
        rows += [
            ("result", f"{size(job.outcome.size_bytes)}, {job.outcome.particle_count} particles"),
            (
                "cost",
                f"{job.outcome.cpu_seconds:.0f} CPU s, {size(job.outcome.peak_memory_mb * 1e6)}",
            ),
        ]
    if job.problem:
        rows += [("cause", job.problem.cause), ("remedy", job.problem.remedy)]
    print_table(("job", job.id), [row for row in rows if row[1]])


def print_outcome(job: Job) -> None:
    """What a finished job has come to: headline metrics and its cost, or why it failed."""
    if job.outcome is None:
        sys.stdout.write(f"{job.id} {_state(job)}\n")
        if job.problem:
            sys.stdout.write(f"{job.problem.cause}\n{job.problem.remedy}\n")
        return
    metrics = job.outcome.metrics
    print_metrics({name: metrics[name] for name in HEADLINE if name in metrics})
    sys.stdout.write(
        f"\n{job.outcome.frames} frames of {job.outcome.particle_count} particles "
        f"({job.outcome.cpu_seconds:.0f} CPU s, {size(job.outcome.peak_memory_mb * 1e6)}): "
        f"morph fetch {job.id}\n"
    )


def print_sweep(sweep: Sweep) -> None:
    """The combined table of a sweep."""
    print_table(
        ("job", "source", "target", "method", "seed", "state", "two_sided", "f1", "many_to_one"),
        (
            (
                row.job,
                row.source,
                row.target,
                row.method,
                str(row.seed),
                row.state.value,
                *(_metric(row.metrics, name) for name in ("two_sided", "f1", "many_to_one")),
            )
            for row in sweep.rows
        ),
    )
    counts = ", ".join(f"{count} {state.value}" for state, count in sweep.counts.items() if count)
    sys.stdout.write(f"\nsweep {sweep.id}: {counts}\n")


def moment(time: datetime | None) -> str:
    """A time of the day on the user's clock, with its date."""
    return f"{time.astimezone():%Y-%m-%d %H:%M:%S}" if time else ""


def _metric(metrics: dict[str, float], name: str) -> str:
    return f"{metrics[name]:.4g}" if name in metrics else ""


def _state(job: Job) -> str:
    words = job.state.value.replace("_", " ")
    return f"{words}, {job.queue_position} before it" if job.queue_position else words
