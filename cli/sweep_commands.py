"""The command on sweeps of the service: sweep."""

from __future__ import annotations

from typing import Annotated

import typer

from chamfer_morph.cli.arguments import parse_list, parse_overrides, parse_seeds
from chamfer_morph.cli.exit_status import JOB_FAILED, print_json
from chamfer_morph.cli.options import (
    DeviceOption,
    FitOption,
    FrameCountOption,
    IdempotencyKeyOption,
    JsonOption,
    KeyOption,
    NameOption,
    PointsOption,
    PresetOption,
    PriorityOption,
    QuietOption,
    ServerOption,
    SetOption,
    TimeoutOption,
    WatchOption,
    connect,
)
from morph_engine.errors import ConfigError

app: typer.Typer = typer.Typer()


@app.command(rich_help_panel="Jobs of the service")
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
    frames: FrameCountOption = None,
    points_per_cell_edge: PointsOption = None,
    fit: FitOption = None,
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
    """Have every combination of sources, targets, methods and seeds computed, or show a sweep."""
    from chamfer_morph.cli.job_tables import print_sweep

    if not sweep_id and not (sources and targets):
        raise ConfigError(
            "A sweep needs --sources and --targets.",
            "Name them, separated by commas, or give the id of a sweep to be shown.",
        )
    with connect(server, key) as client:
        if sweep_id:
            found = client.sweep_status(sweep_id)
        else:
            found = client.sweep(
                parse_list(sources),
                parse_list(targets),
                methods=parse_list(methods),
                seeds=parse_seeds(seeds),
                preset=preset,
                frames=frames,
                overrides=parse_overrides(
                    settings, points_per_cell_edge=points_per_cell_edge, fit=fit
                ),
                device=device,
                priority=priority,
                timeout_seconds=timeout,
                name=name,
                idempotency_key=idempotency_key,
            )
        if watch:
            from chamfer_morph.cli.watching import watch_sweep

            found = watch_sweep(client, found, quiet=quiet, as_json=as_json)
    if as_json:
        print_json(found)
    else:
        print_sweep(found)
    if watch and any(row.state != "succeeded" for row in found.rows):
        raise typer.Exit(JOB_FAILED)
