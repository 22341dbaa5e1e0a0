"""Commands on jobs of the service: submit, watch, fetch and the rest."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.arguments import check_output, default_output, parse_overrides
from chamfer_morph.cli.exit_status import BAD_INPUT, JOB_FAILED, error_document, print_json
from chamfer_morph.cli.options import (
    DeviceOption,
    FitOption,
    ForceOption,
    FrameCountOption,
    IdempotencyKeyOption,
    JobArgument,
    JsonOption,
    KeyOption,
    MethodOption,
    NameOption,
    PointsOption,
    PresetOption,
    PriorityOption,
    QuietOption,
    ResultFileOption,
    SeedOption,
    ServerOption,
    SetOption,
    TargetArgument,
    TimeoutOption,
    WatchOption,
    connect,
)
from morph_engine.errors import MorphError

if TYPE_CHECKING:
    from chamfer_morph.client import MorphClient
    from chamfer_morph.schemas import Job

app: typer.Typer = typer.Typer()
PANEL = "Jobs of the service"

SHAPE_HELP = "A mesh file, which is uploaded, or a built-in shape (see morph shapes)."

State = Literal["queued", "running", "succeeded", "failed", "cancelled", "timed_out"]

JobArguments = Annotated[list[str], typer.Argument(metavar="JOB...", help="Ids of jobs.")]


@app.command(rich_help_panel=PANEL)
def submit(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SHAPE_HELP)],
    target: TargetArgument,
    method: MethodOption = None,
    preset: PresetOption = "fast",
    frames: FrameCountOption = None,
    points_per_cell_edge: PointsOption = None,
    fit: FitOption = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    device: DeviceOption = "auto",
    priority: PriorityOption = 100,
    timeout: TimeoutOption = None,
    name: NameOption = "",
    idempotency_key: IdempotencyKeyOption = None,
    watch: WatchOption = False,
    quiet: QuietOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Have the service morph SOURCE into TARGET; prints the id of the job."""
    import uuid

    once = idempotency_key or str(uuid.uuid4())
    with (
        connect(server, key) as client,
        interrupt.at_interrupt(lambda: _report_interrupted_submission(once)),
    ):
        job = client.submit(
            source,
            target,
            preset=preset,
            method=method,
            frames=frames,
            seed=seed,
            overrides=parse_overrides(settings, points_per_cell_edge=points_per_cell_edge, fit=fit),
            device=device,
            priority=priority,
            timeout_seconds=timeout,
            name=name,
            idempotency_key=once,
        )
        if watch:
            return _watch_to_end(client, job, quiet=quiet, as_json=as_json)
    if as_json:
        print_json(job)
    else:
        typer.echo(job.id)
        if not quiet:
            typer.echo(f"See it with morph watch {job.id}", err=True)


@app.command(rich_help_panel=PANEL)
def jobs(
    state: Annotated[State | None, typer.Option(help="Only jobs in this state.")] = None,
    method: Annotated[str | None, typer.Option(help="Only jobs of this method.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="At most so many.")] = 20,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """List jobs, the newest first."""
    from chamfer_morph.cli.job_tables import print_jobs

    with connect(server, key) as client:
        found = list(islice(client.jobs(state=state, method=method), limit))
    if as_json:
        print_json({"jobs": found})
    else:
        print_jobs(found)


@app.command(rich_help_panel=PANEL)
def show(
    job_id: JobArgument,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show a job as it stands."""
    from chamfer_morph.cli.job_tables import print_job

    with connect(server, key) as client:
        job = client.job(job_id)
    if as_json:
        print_json(job)
    else:
        print_job(job)


@app.command(rich_help_panel=PANEL)
def watch(
    job_id: JobArgument,
    quiet: QuietOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the progress of a job until its end; Ctrl-C leaves the job alone."""
    with connect(server, key) as client:
        _watch_to_end(client, client.job(job_id), quiet=quiet, as_json=as_json)


def _add_command(name: str, help: str, apply: Callable[[MorphClient, str], dict[str, Any]]) -> None:
    """Add a command that does the same with each job that it is given."""

    @app.command(name, help=help, rich_help_panel=PANEL)
    def command(
        job_ids: JobArguments,
        server: ServerOption = None,
        key: KeyOption = None,
        as_json: JsonOption = False,
    ) -> None:
        with connect(server, key) as client:
            _apply_to_each(job_ids, partial(apply, client), as_json=as_json)


def _delete(client: MorphClient, job_id: str) -> dict[str, Any]:
    client.delete(job_id)
    return {"id": job_id, "state": "deleted"}


_add_command(
    "cancel",
    "Stop jobs; their finished frames stay.",
    lambda client, job: client.cancel(job).model_dump(mode="json"),
)
_add_command(
    "retry",
    "Compute finished jobs again from the beginning; what they left is deleted.",
    lambda client, job: client.retry(job).model_dump(mode="json"),
)
_add_command(
    "resume",
    "Let cancelled or failed jobs go on after their last finished frame.",
    lambda client, job: client.resume(job).model_dump(mode="json"),
)
_add_command("delete", "Delete finished jobs and their results.", _delete)


@app.command(rich_help_panel=PANEL)
def fetch(
    job_id: JobArgument,
    out: ResultFileOption = None,
    force: ForceOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fetch the result of a job; an interrupted download goes on where it broke off."""
    from chamfer_morph.cli.tables import size

    with connect(server, key) as client:
        job = client.job(job_id)
        path = out or default_output(
            job.source_name, job.target_name, partial=job.state != "succeeded"
        )
        check_output(path, force=force)
        client.download(job_id, path)
    byte_count = path.stat().st_size
    if as_json:
        print_json({"job": job_id, "out": str(path), "size_bytes": byte_count})
    else:
        typer.echo(f"{path} ({size(byte_count)})")


def _watch_to_end(client: MorphClient, job: Job, *, quiet: bool, as_json: bool) -> None:
    """Watch a job, print what it has come to, and exit with 1 unless it has succeeded."""
    from chamfer_morph.cli.job_tables import print_outcome
    from chamfer_morph.cli.watching import watch_job

    job = watch_job(client, job, quiet=quiet, as_json=as_json)
    if as_json:
        print_json(job)
    else:
        print_outcome(job)
    if job.state != "succeeded":
        raise typer.Exit(JOB_FAILED)


def _report_interrupted_submission(key: str) -> None:
    interrupt.report(
        "Stopped by Ctrl-C; the job may have been submitted.",
        f"Look with morph jobs, or repeat the command with --idempotency-key {key}.",
    )


def _apply_to_each(
    job_ids: list[str], apply: Callable[[str], dict[str, Any]], *, as_json: bool
) -> None:
    """Do something with each job; one that is refused does not keep the others from it.

    Exits with 2 if any was refused.

    Raises:
        ServiceError: The service does not answer.
    """
    from chamfer_morph.client.errors import ServiceError

    done: list[dict[str, Any]] = []
    refused: list[tuple[str, MorphError]] = []
    for job_id in job_ids:
        try:
            done.append(apply(job_id))
        except ServiceError as error:
            if error.exit_status != BAD_INPUT:
                raise
            refused.append((job_id, error))
    if as_json:
        errors = [{"job": job_id} | error_document(problem) for job_id, problem in refused]
        print_json({"jobs": done, "errors": errors})
    else:
        for document in done:
            typer.echo(f"{document['id']}  {document['state']}")
    for _, problem in refused:
        sys.stderr.write(f"{problem.cause}\n{problem.remedy}\n")
    if refused:
        raise typer.Exit(BAD_INPUT)
