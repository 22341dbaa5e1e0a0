"""Commands on jobs of the service: submit, watch, fetch and the rest."""

from __future__ import annotations

import sys
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from chamfer_morph.cli.arguments import check_output, default_output, parse_settings
from chamfer_morph.cli.exit_status import BAD_INPUT, JOB_FAILED
from chamfer_morph.cli.idempotency import repeatable
from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import (
    ConfigOptions,
    ForceOption,
    IdempotencyKeyOption,
    MethodOption,
    QuietOption,
    ResultFileOption,
    SeedOption,
    ServiceOptions,
    SubmissionOptions,
    TargetArguments,
    WatchOption,
)
from chamfer_morph.cli.output import error_document, in_flags, print_json
from chamfer_morph.cli.tables import format_size, print_job, print_jobs, print_outcome
from morph_engine.errors import MorphError

if TYPE_CHECKING:
    from chamfer_morph.client import MorphClient
    from chamfer_morph.schemas import Job

app: typer.Typer = typer.Typer()
PANEL = "Jobs of the service"

SHAPE_HELP = "A mesh file to upload, or a built-in shape (see morph shapes)."

State = Literal["queued", "running", "succeeded", "failed", "cancelled", "timed_out"]

JobArgument = Annotated[str, typer.Argument(metavar="JOB", help="Id of a job.")]
JobArguments = Annotated[list[str], typer.Argument(metavar="JOB...", help="Ids of jobs.")]


@app.command(rich_help_panel=PANEL)
@expand_groups
def submit(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SHAPE_HELP)],
    targets: TargetArguments,
    *,
    method: MethodOption = None,
    config: ConfigOptions,
    seed: SeedOption = None,
    submission: SubmissionOptions,
    watch: WatchOption = False,
    quiet: QuietOption = False,
    service: ServiceOptions,
) -> None:
    """Submit a morph of SOURCE into TARGET, or through several; prints the id of the job."""
    with service.connect() as client, repeatable(submission.idempotency_key, "the job") as key:
        job = client.submit(
            source,
            targets,
            method=method,
            seed=seed,
            idempotency_key=key,
            **submission.request(config),
        )
        if watch:
            return _watch_to_end(client, job, service, quiet=quiet)
    service.print(job, job.id)
    if not (service.as_json or quiet):
        typer.echo(f"See it with morph watch {job.id}", err=True)


@app.command(rich_help_panel=PANEL)
@expand_groups
def jobs(
    *,
    state: Annotated[State | None, typer.Option(help="Only jobs in this state.")] = None,
    method: Annotated[str | None, typer.Option(help="Only jobs of this method.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number to list.")] = 20,
    service: ServiceOptions,
) -> None:
    """List jobs, the newest first."""
    with service.connect() as client:
        found = list(islice(client.jobs(state=state, method=method), limit))
    service.print({"jobs": found}, lambda: print_jobs(found))


@app.command(rich_help_panel=PANEL)
@expand_groups
def show(job_id: JobArgument, service: ServiceOptions) -> None:
    """Show the current state of a job."""
    with service.connect() as client:
        job = client.job(job_id)
    service.print(job, lambda: print_job(job))


@app.command(rich_help_panel=PANEL)
@expand_groups
def watch(job_id: JobArgument, *, quiet: QuietOption = False, service: ServiceOptions) -> None:
    """Show the progress of a job until it ends; Ctrl-C stops watching, not the job."""
    with service.connect() as client:
        _watch_to_end(client, client.job(job_id), service, quiet=quiet)


@app.command(rich_help_panel=PANEL)
@expand_groups
def fetch(
    job_id: JobArgument,
    *,
    out: ResultFileOption = None,
    force: ForceOption = False,
    service: ServiceOptions,
) -> None:
    """Fetch the result of a job; an interrupted download continues where it stopped."""
    with service.connect() as client:
        job = client.job(job_id)
        path = out or default_output(
            job.source_name, *job.via_names, job.target_name, partial=job.state != "succeeded"
        )
        check_output(path, force=force)
        client.download(job_id, path)
    byte_count = path.stat().st_size
    service.print(
        {"job": job_id, "out": str(path), "size_bytes": byte_count},
        f"{path} ({format_size(byte_count)})",
    )


@app.command(rich_help_panel=PANEL)
@expand_groups
def fork(
    job_id: JobArgument,
    *,
    frame: Annotated[
        int | None,
        typer.Option(
            help="Last frame to keep, counted from 0; default: the last one with a full state."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PATH=VALUE", help="A setting to change."),
    ] = None,
    name: Annotated[str, typer.Option(help="A name of your choice.")] = "",
    states_every: Annotated[
        int, typer.Option(help="Keep the full state after every N frames.")
    ] = 0,
    idempotency_key: IdempotencyKeyOption = None,
    watch: WatchOption = False,
    quiet: QuietOption = False,
    service: ServiceOptions,
) -> None:
    """Continue from a frame of a job with other settings, as a new job; prints its id."""
    overrides = parse_settings(settings or ())
    with service.connect() as client, repeatable(idempotency_key, "the job") as key:
        job = client.fork(
            job_id,
            frame,
            overrides=overrides,
            name=name,
            states_every=states_every,
            idempotency_key=key,
        )
        if watch:
            return _watch_to_end(client, job, service, quiet=quiet)
    service.print(job, job.id)


def _watch_to_end(client: MorphClient, job: Job, service: ServiceOptions, *, quiet: bool) -> None:
    """Watch a job, print what it has come to, and exit with 1 unless it has succeeded."""
    from chamfer_morph.cli.watching import watch_job

    job = watch_job(client, job, quiet=quiet, as_json=service.as_json)
    service.print(job, lambda: print_outcome(job))
    if job.state != "succeeded":
        raise typer.Exit(JOB_FAILED)


def _add_command(name: str, help: str, method: str = "") -> None:
    """Add the command that does with each job what a method of the client does, by its name.

    One that is refused does not keep the others from it; the exit status is 2 then.
    """

    @app.command(name, help=help, rich_help_panel=PANEL)
    @expand_groups
    def command(job_ids: JobArguments, service: ServiceOptions) -> None:
        from chamfer_morph.client.errors import ServiceError

        done: list[dict[str, Any]] = []
        refused: list[tuple[str, MorphError]] = []
        with service.connect() as client:
            for job_id in job_ids:
                try:
                    job = getattr(client, method or name)(job_id)
                except ServiceError as error:
                    if error.exit_status != BAD_INPUT:
                        raise
                    refused.append((job_id, error))
                else:
                    deleted = {"id": job_id, "state": "deleted"}
                    done.append(job.model_dump(mode="json") if job else deleted)
        if service.as_json:
            errors = [{"job": job_id} | error_document(problem) for job_id, problem in refused]
            print_json({"jobs": done, "errors": errors})
        else:
            for document in done:
                typer.echo(f"{document['id']}  {document['state']}")
        for _, problem in refused:
            sys.stderr.write(f"{problem.cause}\n{in_flags(problem.remedy)}\n")
        if refused:
            raise typer.Exit(BAD_INPUT)


_add_command("cancel", "Stop jobs; their finished frames stay.")
_add_command("next", "Move queued jobs ahead of your others, the last named first.", "put_first")
_add_command(
    "retry", "Compute finished jobs again from the beginning; their old output is deleted."
)
_add_command("resume", "Continue cancelled or failed jobs after their last finished frame.")
_add_command("delete", "Delete finished jobs and their results.")
