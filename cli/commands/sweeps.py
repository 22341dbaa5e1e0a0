"""The command on sweeps of the service: sweep."""

from __future__ import annotations

from typing import Annotated

import typer

from chamfer_morph.cli.arguments import parse_list, parse_seeds
from chamfer_morph.cli.exit_status import JOB_FAILED
from chamfer_morph.cli.idempotency import repeatable
from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import (
    ConfigOptions,
    QuietOption,
    ServiceOptions,
    SubmissionOptions,
    WatchOption,
)
from chamfer_morph.cli.tables import print_sweep
from morph_engine.errors import ConfigError

app: typer.Typer = typer.Typer()


@app.command(rich_help_panel="Jobs of the service")
@expand_groups
def sweep(
    sweep_id: Annotated[
        str | None,
        typer.Argument(
            metavar="[SWEEP]", help="Id of a sweep to show; omit it to submit a new one."
        ),
    ] = None,
    *,
    sources: Annotated[
        str, typer.Option(metavar="A,B", help="Mesh files or built-in shapes.")
    ] = "",
    targets: Annotated[str, typer.Option(metavar="C,D", help="Targets, of the same kinds.")] = "",
    methods: Annotated[str, typer.Option(metavar="M,N", help="See morph methods.")] = "flow",
    seeds: Annotated[str, typer.Option(metavar="1,2", help="Random seeds.")] = "42",
    config: ConfigOptions,
    submission: SubmissionOptions,
    watch: WatchOption = False,
    quiet: QuietOption = False,
    service: ServiceOptions,
) -> None:
    """Submit every combination of sources, targets, methods and seeds, or show a sweep."""
    if not sweep_id and not (sources and targets):
        raise ConfigError(
            "A sweep needs --sources and --targets.",
            "Give both, separated by commas, or the id of a sweep to show.",
        )
    with service.connect() as client:
        if sweep_id:
            found = client.sweep_status(sweep_id)
        else:
            with repeatable(submission.idempotency_key, "the sweep") as key:
                found = client.sweep(
                    parse_list(sources),
                    parse_list(targets),
                    methods=parse_list(methods),
                    seeds=parse_seeds(seeds),
                    idempotency_key=key,
                    **submission.request(config),
                )
        if watch:
            from chamfer_morph.cli.watching import watch_sweep

            found = watch_sweep(client, found, quiet=quiet, as_json=service.as_json)
    service.print(found, lambda: print_sweep(found))
    if watch and any(row.state != "succeeded" for row in found.rows):
        raise typer.Exit(JOB_FAILED)
