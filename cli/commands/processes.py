"""Commands that start the processes of the service on this machine."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from chamfer_morph.cli.exit_status import BAD_INPUT
from chamfer_morph.cli.interrupt import INTERRUPTED
from morph_engine.child_process import python_command
from morph_engine.errors import ConfigError

PANEL = "The service"

app: typer.Typer = typer.Typer()

DataDirOption = Annotated[Path | None, typer.Option(help="Folder for all data.")]


@app.command(rich_help_panel=PANEL)
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one.")] = None,
    workers: Annotated[int | None, typer.Option(help="Jobs to compute at the same time.")] = None,
    data_dir: DataDirOption = None,
) -> None:
    """Run the service on this machine: API, workers and janitor; Ctrl-C stops it, losing nothing.

    All other settings are MORPH_* environment variables, see docs/settings.md.
    """
    import_module("chamfer_morph.server")  # says so here if the extra `service` is absent
    options = {"HOST": host, "PORT": port, "WORKERS": workers, "DATA_DIR": data_dir}
    command = python_command("chamfer_morph.server", "serve")
    os.execve(command[0], command, _environment(options))


@app.command(rich_help_panel=PANEL)
def worker(
    slots: Annotated[
        int | None, typer.Option(min=1, max=256, help="Jobs to compute at the same time.")
    ] = None,
    gpus: Annotated[
        str | None, typer.Option(metavar="all|0,2", help="A worker for each of these GPUs.")
    ] = None,
    first_slot: Annotated[
        int,
        typer.Option(min=0, help="Number of the first slot, if other workers run on this machine."),
    ] = 0,
    data_dir: DataDirOption = None,
) -> None:
    """Run workers on this machine for the service of MORPH_DATABASE_URL and MORPH_DATA_DIR.

    Workers that die are restarted. Ctrl-C or SIGTERM stops them all; their jobs continue
    elsewhere.
    """
    from chamfer_morph.cli.gpu_selection import chosen_gpus, slots_of
    from chamfer_morph.worker.settings import load_settings
    from chamfer_morph.worker.supervisor import StopSignals, supervise, worker_slot

    if slots is not None and gpus is not None:
        raise ConfigError("--slots and --gpus cannot be combined.", "Use only one of them.")
    load_settings()  # a wrong one ends this process, not one worker after the other
    own: dict[int, dict[str, str]] = {first_slot + place: {} for place in range(slots or 1)}
    if gpus is not None:
        chosen = slots_of(chosen_gpus(gpus), first_slot)
        own = {slot: {"CUDA_VISIBLE_DEVICES": gpu} for slot, gpu in chosen.items()}
    shared = _environment({"DATA_DIR": data_dir, "WORKERS": len(own)})  # they share the cores
    processes = [
        worker_slot(slot, shared | settings, may_refuse=True) for slot, settings in own.items()
    ]
    stop = StopSignals()
    supervise(processes, stop)
    if any(process.refused for process in processes):
        raise typer.Exit(BAD_INPUT)
    raise typer.Exit(INTERRUPTED if stop.received == signal.SIGINT else 0)


def _environment(options: Mapping[str, object]) -> dict[str, str]:
    """This process's environment with settings of the service."""
    given = {f"MORPH_{name}": str(value) for name, value in options.items() if value is not None}
    return os.environ | given
