"""Tables on standard output, and how numbers are written for people."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from rich.console import Console
from rich.table import Table
from rich.text import Text

from chamfer_morph.cli.output import in_flags
from morph_engine.errors import ConfigError

if TYPE_CHECKING:
    from datetime import datetime

    from pydantic.fields import FieldInfo

    from chamfer_morph.schemas import Job, JobState, Outcome, Sweep
    from morph_engine.config import MorphConfig
    from morph_engine.ingest import IngestReport

PIPED_WIDTH = 240
"""Columns of a table that goes into a file or another program."""


def format_losses(metrics: Mapping[str, float]) -> str:
    """The two numbers that tell how a run is going: loss and two-sided Chamfer distance [dx]."""
    parts = [
        f"{label} {metrics[name]:.4g}"
        for label, name in (("loss", "loss_physics"), ("CD", "two_sided"))
        if name in metrics
    ]
    return "  ".join(parts)


def format_duration(seconds: float) -> str:
    """A duration as people read it: 0:07, 12:40, 1:02:03."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"


def format_size(byte_count: float) -> str:
    """A number of bytes as people read it: 20 kB, 512 MB, 1.3 GB."""
    megabytes = byte_count / 1e6
    if megabytes < 1:
        return f"{byte_count / 1e3:.0f} kB"
    return f"{megabytes / 1e3:.1f} GB" if megabytes >= 1000 else f"{megabytes:.0f} MB"


def format_counts(counts: Mapping[JobState, int]) -> str:
    """How many jobs are in which state: 3 succeeded, 1 running."""
    return ", ".join(f"{count} {state.value}" for state, count in counts.items() if count)


def print_report(report: IngestReport) -> None:
    """What the engine sees in a mesh, on standard output."""
    lower, upper = report.bounds
    yes_no = {True: "yes", False: "no"}
    print_table(
        ("mesh", report.name),
        (
            ("vertices, faces", f"{report.vertex_count}, {report.face_count}"),
            ("parts, Euler number", f"{report.component_count}, {report.euler}"),
            ("watertight", yes_no[report.watertight]),
            ("open edges", f"{report.open_edge_count}"),
            ("ambiguous winding", f"{report.ambiguous_winding:.2%}"),
            ("volume", f"{report.volume:.6g}"),
            ("from", " ".join(f"{value:.4g}" for value in lower)),
            ("to", " ".join(f"{value:.4g}" for value in upper)),
            ("colours", report.colors),
            ("upwards", report.up or "not known"),
            ("fits the domain", yes_no[report.fits_domain]),
        ),
    )
    if report.resolutions:
        sys.stdout.write("\n")
        print_table(
            ("points per cell edge", "particles", "time", "memory"),
            (
                (
                    f"{resolution.points_per_cell_edge}",
                    f"{resolution.particle_count}",
                    format_duration(resolution.estimate.seconds),
                    format_size(resolution.estimate.memory_mb * 1e6),
                )
                for resolution in report.resolutions
            ),
        )
    if report.placement:
        sys.stdout.write(f"\n{report.placement}\n")
    for warning in report.warnings:
        sys.stdout.write(f"\n{warning}\n")


def print_settings(config: MorphConfig, *, section: str | None = None) -> None:
    """Settings of all sections, or of one, with value, range and meaning, on standard output.

    Raises:
        ConfigError: There is no such section.
    """
    from morph_engine.config import setting_fields

    known = setting_fields(config.method.name)
    fields = {
        path: field
        for path, field in known.items()
        if section is None or f"{path}.".startswith(f"{section}.")
    }
    if not fields:
        sections = dict.fromkeys(path.split(".")[0] for path in known if "." in path)
        raise ConfigError(
            f"There is no section called {section!r}.", f"Choose one of {', '.join(sections)}."
        )
    print_table(("setting", "value", "allowed", "meaning"), settings_rows(config, fields))


def settings_rows(
    config: MorphConfig, fields: Mapping[str, FieldInfo]
) -> Iterator[tuple[str, str, str, str]]:
    """Path, value, range and meaning of settings, given by their paths."""
    for path, field in fields.items():
        yield path, _setting(config, path), _allowed(field), field.description or ""


def _setting(config: MorphConfig, path: str) -> str:
    if path == "method":
        return config.method.name
    shared = path.split(".")[0] in type(config).model_fields
    value = attrgetter(path)(config if shared else config.method)
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _allowed(field: FieldInfo) -> str:
    """The range of a setting in words: `>0, <=1`, or its choices `cubic | quadratic`."""
    if get_origin(field.annotation) is Literal:
        return " | ".join(get_args(field.annotation))
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    return ", ".join(
        f"{sign}{getattr(bound, name):g}"
        for bound in field.metadata
        for name, sign in signs.items()
        if hasattr(bound, name)
    )


def print_summary(document: Mapping[str, Any]) -> None:
    """The end of a run on standard output: how good it is, what it cost, and what to do next."""
    if "cover" in document:  # a run that is unfinished has no such metrics
        sys.stdout.write(f"{quality(document)}\n")
    sys.stdout.write(
        f"{document['frames']} frames of {document['particle_count']:,} particles in "
        f"{format_duration(document['wall_s'])} ({document['cpu_s']:.0f} CPU s, "
        f"{format_size(document['peak_rss_mb'] * 1e6)}): {document['out']}\n"
    )
    out = shlex.quote(document["out"])
    sys.stdout.write(f"view it:     morph view {out}\nall metrics: morph metrics {out}\n")


def quality(metrics: Mapping[str, float]) -> str:
    """How well particles fill the target, in a sentence."""
    low, high = metrics["rho_p05"], metrics["rho_p95"]
    words = (
        f"{metrics['cover']:.0%} of the target is filled, {metrics['spill']:.0%} of the fill "
        f"lies outside it; density {low:.2f} to {high:.2f} of an even fill's."
    )
    escaped = int(metrics.get("escaped", 0))
    return f"{words} {escaped} particles left the domain." if escaped else words


def print_metrics(values: Mapping[str, float]) -> None:
    """Metrics with their units and meanings on standard output."""
    from morph_engine.metrics.definitions import METRICS

    print_table(
        ("metric", "value", "unit", "meaning"),
        (
            (name, f"{value:.4g}", METRICS[name].unit, METRICS[name].meaning)
            for name, value in values.items()
            if name in METRICS
        ),
    )


def print_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table on standard output."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    for column, name in enumerate(header):
        table.add_column(name, overflow="fold", no_wrap=column == 0)
    for row in rows:
        table.add_row(*map(Text, row))  # Text: brackets are brackets, not markup
    width = None if sys.stdout.isatty() else PIPED_WIDTH
    Console(highlight=False, width=width).print(table)


def print_jobs(jobs: Iterable[Job]) -> None:
    """A line a job."""
    print_table(
        ("job", "state", "frames", "morph", "method", "submitted", "name"),
        (
            (
                job.id,
                job.state.value,
                f"{job.progress.frame}/{job.progress.frames}",
                " to ".join((job.source_name, *job.via_names, job.target_name)),
                job.method,
                local_time(job.created_at),
                job.name,
            )
            for job in jobs
        ),
    )


def print_job(job: Job) -> None:
    """Everything about a job."""
    seconds_left = job.progress.seconds_left
    rows = [
        ("state", _state(job)),
        ("morph", " to ".join((job.source_name, *job.via_names, job.target_name))),
        ("method, preset, seed", f"{job.method}, {job.preset}, {job.seed}"),
        ("device, priority", f"{job.device}, {job.priority}"),
        ("frames", f"{job.progress.frame} of {job.progress.frames}"),
        ("metrics", format_losses(job.progress.metrics)),
        ("time left", "" if seconds_left is None else format_duration(seconds_left)),
        ("submitted", local_time(job.created_at)),
        ("started", local_time(job.started_at)),
        ("finished", local_time(job.finished_at)),
        ("attempt", str(job.progress.attempt or "")),
        ("name", job.name),
        ("owner", job.owner),
        ("sweep", job.sweep or ""),
    ]
    if job.outcome:
        size = format_size(job.outcome.size_bytes)
        rows += [
            ("result", f"{size}, {job.outcome.particle_count} particles"),
            ("cost", _cost(job.outcome)),
        ]
    if job.problem:
        rows += [("cause", job.problem.cause), ("remedy", in_flags(job.problem.remedy))]
    print_table(("job", job.id), [row for row in rows if row[1]])


def _cost(outcome: Outcome) -> str:
    memory = format_size(outcome.peak_memory_mb * 1e6)
    return f"{outcome.cpu_seconds:.0f} CPU s, {memory}"


def print_outcome(job: Job) -> None:
    """What a finished job has come to: how good it is and what it cost, or why it failed."""
    if job.outcome is None:
        sys.stdout.write(f"{job.id} {_state(job)}\n")
        if job.problem:
            sys.stdout.write(f"{job.problem.cause}\n{in_flags(job.problem.remedy)}\n")
        return
    if "cover" in job.outcome.metrics:
        sys.stdout.write(f"{quality(job.outcome.metrics)}\n")
    sys.stdout.write(
        f"{job.outcome.frames} frames of {job.outcome.particle_count:,} particles "
        f"({_cost(job.outcome)}): job {job.id}\nview it:  morph view {job.id}\n"
        f"fetch it: morph fetch {job.id}\n"
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
    sys.stdout.write(f"\nsweep {sweep.id}: {format_counts(sweep.counts)}\n")


def local_time(time: datetime | None) -> str:
    """A time in the time zone of this machine; empty for None."""
    return f"{time.astimezone():%Y-%m-%d %H:%M:%S}" if time else ""


def _metric(metrics: dict[str, float], name: str) -> str:
    return f"{metrics[name]:.4g}" if name in metrics else ""


def _state(job: Job) -> str:
    words = job.state.value.replace("_", " ")
    return f"{words}, {job.queue_position} before it" if job.queue_position else words
