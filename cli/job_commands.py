"""Commands on jobs of the service: submit, watch, fetch and the rest."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.connection import KeyOption, ServerOption, connect
from chamfer_morph.cli.exit_status import BAD_INPUT, error_document, print_json
from morph_engine.errors import ConfigError, MorphError

if TYPE_CHECKING:
    from chamfer_morph.client.client import MorphClient
    from chamfer_morph.schemas import Job, Sweep

app = typer.Typer(rich_markup_mode=None)
PANEL = "Jobs of the service"

JOB_FAILED = 1

SHAPE_HELP = "A mesh file, which is uploaded, or a built-in shape (see morph shapes)."

Device = Literal["auto", "cpu", "cuda", "vulkan", "metal"]
State = Literal["queued", "running", "succeeded", "failed", "cancelled", "timed_out"]
Fit = Literal["volume", "extent", "none"]

JobArgument = Annotated[str, typer.Argument(metavar="JOB", help="Id of a job.")]
JobArguments = Annotated[list[str], typer.Argument(metavar="JOB...", help="Ids of jobs.")]
PresetOption = Annotated[str, typer.Option(help="See morph presets.")]
FramesOption = Annotated[int | None, typer.Option(help="Frames to compute.")]
PointsOption = Annotated[
    int | None, typer.Option(help="Particles per grid cell edge: 2 quick, 3 usual, 4 fine.")
]
FitOption = Annotated[
    Fit | None,
    typer.Option(help="Scale to the usual volume, to touch the domain, or keep the coordinates."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Any setting; see morph presets fast."),
]
DeviceOption = Annotated[Device, typer.Option(help="Where to compute.")]
PriorityOption = Annotated[int, typer.Option(help="1 to 1000; smaller runs earlier among yours.")]
TimeoutOption = Annotated[
    float | None, typer.Option(help="Stop a job that computes for longer [s].")
]
NameOption = Annotated[str, typer.Option(help="A name for your own use.")]
OnceOption = Annotated[
    str | None,
    typer.Option(metavar="KEY", help="Commands with the same key have one effect between them."),
]
WatchOption = Annotated[bool, typer.Option("--watch", help="Show progress until the end.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Show no progress.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


@app.command(rich_help_panel=PANEL)
def submit(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SHAPE_HELP)],
    target: Annotated[str, typer.Argument(metavar="TARGET", help="What it is to become.")],
    method: Annotated[str | None, typer.Option(help="See morph methods.")] = None,
    preset: PresetOption = "fast",
    frames: FramesOption = None,
    points_per_cell_edge: PointsOption = None,
    fit: FitOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random choice.")] = None,
    settings: SetOption = None,
    device: DeviceOption = "auto",
    priority: PriorityOption = 100,
    timeout: TimeoutOption = None,
    name: NameOption = "",
    idempotency_key: OnceOption = None,
    watch: WatchOption = False,
    quiet: QuietOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: AsJson = False,
) -> None:
    """Have the service morph SOURCE into TARGET; prints the id of the job."""
    import uuid

    once = idempotency_key or str(uuid.uuid4())
    with connect(server, key) as client, interrupt.at_interrupt(lambda: _say_repeat(once)):
        job = client.submit(
            source,
            target,
            preset=preset,
            method=method,
            frames=frames,
            seed=seed,
            overrides=_overrides(points_per_cell_edge, fit, settings),
            device=device,
            priority=priority,
            timeout_seconds=timeout,
            name=name,
            idempotency_key=once,
        )
        if watch:
            return _watch_to_end(client, job, quiet=quiet, as_json=as_json)
    if as_json:
        print_json(_document(job))
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
    as_json: AsJson = False,
) -> None:
    """List jobs, the newest first."""
    from chamfer_morph.cli.job_tables import print_jobs

    with connect(server, key) as client:
        found = list(islice(client.jobs(state=state, method=method), limit))
    if as_json:
        print_json({"jobs": [_document(job) for job in found]})
    else:
        print_jobs(found)


@app.command(rich_help_panel=PANEL)
def show(
    job_id: JobArgument,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: AsJson = False,
) -> None:
    """Show a job as it stands."""
    from chamfer_morph.cli.job_tables import print_job

    with connect(server, key) as client:
        job = client.job(job_id)
    if as_json:
        print_json(_document(job))
    else:
        print_job(job)


@app.command(rich_help_panel=PANEL)
def watch(
    job_id: JobArgument,
    quiet: QuietOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: AsJson = False,
) -> None:
    """Show the progress of a job until its end; Ctrl-C leaves the job alone."""
    with connect(server, key) as client:
        _watch_to_end(client, client.job(job_id), quiet=quiet, as_json=as_json)


def _command(name: str, meaning: str, act: Callable[[MorphClient, str], dict[str, Any]]) -> None:
    """Add a command that does the same with each job that it is given."""

    @app.command(name, help=meaning, rich_help_panel=PANEL)
    def command(
        job_ids: JobArguments,
        server: ServerOption = None,
        key: KeyOption = None,
        as_json: AsJson = False,
    ) -> None:
        with connect(server, key) as client:
            _each(job_ids, partial(act, client), as_json=as_json)


def _delete(client: MorphClient, job_id: str) -> dict[str, Any]:
    client.delete(job_id)
    return {"id": job_id, "state": "deleted"}


_command(
    "cancel",
    "Stop jobs; their finished frames stay.",
    lambda client, job: _document(client.cancel(job)),
)
_command(
    "retry",
    "Compute finished jobs again from the beginning; what they left is deleted.",
    lambda client, job: _document(client.retry(job)),
)
_command(
    "resume",
    "Let cancelled or failed jobs go on after their last finished frame.",
    lambda client, job: _document(client.resume(job)),
)
_command("delete", "Delete finished jobs and their results.", _delete)


@app.command(rich_help_panel=PANEL)
def fetch(
    job_id: JobArgument,
    out: Annotated[
        Path | None, typer.Option(help="Result file; SOURCE-to-TARGET.vtkhdf if not given.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file.")] = False,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: AsJson = False,
) -> None:
    """Fetch the result of a job; an interrupted download goes on where it broke off."""
    from chamfer_morph.cli.arguments import check_place, default_out
    from chamfer_morph.cli.display import size

    with connect(server, key) as client:
        job = client.job(job_id)
        path = out or default_out(
            job.source_name, job.target_name, partial=job.state != "succeeded"
        )
        check_place(path, force=force)
        client.download(job_id, path)
    byte_count = path.stat().st_size
    if as_json:
        print_json({"job": job_id, "out": str(path), "size_bytes": byte_count})
    else:
        typer.echo(f"{path} ({size(byte_count)})")


@app.command(rich_help_panel=PANEL)
def sweep(
    sweep_id: Annotated[
        str | None, typer.Argument(metavar="[SWEEP]", help="Show this sweep; a new one if absent.")
    ] = None,
    sources: Annotated[
        str, typer.Option(metavar="A,B", help="Mesh files or built-in shapes.")
    ] = "",
    targets: Annotated[str, typer.Option(metavar="C,D", help="What they are to become.")] = "",
    methods: Annotated[str, typer.Option(metavar="M,N", help="See morph methods.")] = "transport",
    seeds: Annotated[str, typer.Option(metavar="1,2", help="Seeds of random choices.")] = "42",
    preset: PresetOption = "fast",
    frames: FramesOption = None,
    points_per_cell_edge: PointsOption = None,
    fit: FitOption = None,
    settings: SetOption = None,
    device: DeviceOption = "auto",
    priority: PriorityOption = 100,
    timeout: TimeoutOption = None,
    name: NameOption = "",
    idempotency_key: OnceOption = None,
    watch: WatchOption = False,
    quiet: QuietOption = False,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: AsJson = False,
) -> None:
    """Have every combination of sources, targets, methods and seeds computed, or show a sweep."""
    from chamfer_morph.cli.job_tables import print_sweep

    if not sweep_id and not (sources and targets):
        raise ConfigError(
            "A sweep needs --sources and --targets.",
            "Name them, separated by commas, or give the id of a sweep to be shown.",
        )
    with connect(server, key) as client:
        if sweep_id:
            known = client.sweep_status(sweep_id)
        else:
            known = client.sweep(
                _names(sources),
                _names(targets),
                methods=_names(methods),
                seeds=_numbers(seeds),
                preset=preset,
                frames=frames,
                overrides=_overrides(points_per_cell_edge, fit, settings),
                device=device,
                priority=priority,
                timeout_seconds=timeout,
                name=name,
                idempotency_key=idempotency_key,
            )
        if watch:
            from chamfer_morph.cli.watching import watch_sweep

            with interrupt.at_interrupt(
                lambda: _say_left("sweep", known.id, "sweep", as_json=as_json)
            ):
                known = watch_sweep(client, known, quiet=quiet)
    if as_json:
        print_json(known.model_dump(mode="json"))
    else:
        print_sweep(known)
    if watch and not _all_succeeded(known):
        raise typer.Exit(JOB_FAILED)


def _watch_to_end(client: MorphClient, job: Job, *, quiet: bool, as_json: bool) -> None:
    """Watch a job, say what it has come to, and exit with 1 unless it has succeeded."""
    from chamfer_morph.cli.job_tables import print_end
    from chamfer_morph.cli.watching import watch_job

    with interrupt.at_interrupt(lambda: _say_left("job", job.id, "watch", as_json=as_json)):
        job = watch_job(client, job, quiet=quiet)
    if as_json:
        print_json(_document(job))
    else:
        print_end(job)
    if job.state != "succeeded":
        raise typer.Exit(JOB_FAILED)


def _say_left(kind: str, name: str, command: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"id": name, "interrupted": True})
    interrupt.say(
        f"Stopped watching by Ctrl-C; the {kind} goes on.",
        f"See it again with morph {command} {name}.",
    )


def _say_repeat(key: str) -> None:
    interrupt.say(
        "Stopped by Ctrl-C; the job may have been submitted.",
        f"Look with morph jobs, or repeat the command with --idempotency-key {key}.",
    )


def _each(job_ids: list[str], act: Callable[[str], dict[str, Any]], *, as_json: bool) -> None:
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
            done.append(act(job_id))
        except ServiceError as error:
            if error.exit_status != BAD_INPUT:
                raise
            refused.append((job_id, error))
    if as_json:
        errors = [{"job": job_id} | error_document(why) for job_id, why in refused]
        print_json({"jobs": done, "errors": errors})
    else:
        for document in done:
            typer.echo(f"{document['id']}  {document['state']}")
    for _, why in refused:
        sys.stderr.write(f"{why.cause}\n{why.remedy}\n")
    if refused:
        raise typer.Exit(BAD_INPUT)


def _overrides(
    points_per_cell_edge: int | None, fit: Fit | None, settings: list[str] | None
) -> dict[str, Any]:
    from chamfer_morph.cli.arguments import parse_overrides

    options = {"sampling.points_per_cell_edge": points_per_cell_edge, "sampling.fit": fit}
    chosen = {path: value for path, value in options.items() if value is not None}
    return chosen | parse_overrides(settings or [])


def _names(text: str) -> list[str]:
    return [name for part in text.split(",") if (name := part.strip())]


def _numbers(text: str) -> list[int]:
    try:
        return [int(name) for name in _names(text)]
    except ValueError:
        raise ConfigError(f"--seeds {text} are no numbers.", "Write them as in 1,2,3.") from None


def _all_succeeded(sweep: Sweep) -> bool:
    return all(row.state == "succeeded" for row in sweep.rows)


def _document(job: Job) -> dict[str, Any]:
    return job.model_dump(mode="json")
