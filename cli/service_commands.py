"""Commands on the service itself: API keys and workers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from chamfer_morph.cli.exit_status import print_json
from chamfer_morph.cli.options import JsonOption, KeyOption, ServerOption, connect

if TYPE_CHECKING:
    from chamfer_morph.schemas import WorkerStatus

PANEL = "The service"

app: typer.Typer = typer.Typer()
keys: typer.Typer = typer.Typer(help="API keys of the service.", no_args_is_help=True)
workers: typer.Typer = typer.Typer(help="Worker slots of the service.", no_args_is_help=True)
app.add_typer(keys, name="keys", rich_help_panel=PANEL)
app.add_typer(workers, name="workers", rich_help_panel=PANEL)

NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Name of a key.")]
WorkerArgument = Annotated[
    str, typer.Argument(metavar="WORKER", help="Id of a worker, see morph workers list.")
]


@keys.command("list")
def list_keys(
    server: ServerOption = None, key: KeyOption = None, as_json: JsonOption = False
) -> None:
    """List the API keys; nobody can see their secrets."""
    from chamfer_morph.cli.tables import print_table

    with connect(server, key) as client:
        found = client.keys()
    if as_json:
        print_json({"keys": found})
    else:
        print_table(
            ("key", "may", "since"),
            ((each.name, " ".join(each.scopes), f"{each.created_at:%Y-%m-%d}") for each in found),
        )


@keys.command("create")
def create_key(
    name: NameArgument,
    scope: Annotated[
        list[str] | None,
        typer.Option(help="read, submit or admin, again and again; read and submit if not given."),
    ] = None,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make an API key; prints its secret, which is not shown again."""
    with connect(server, key) as client:
        made = client.create_key(name, scope or ("read", "submit"))
    if as_json:
        print_json(made)
    else:
        typer.echo(made.secret)
        typer.echo("Keep it: it is not shown again.", err=True)


@keys.command("delete")
def delete_key(
    name: NameArgument,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Delete an API key; it is refused from now on."""
    with connect(server, key) as client:
        client.delete_key(name)
    if as_json:
        print_json({"name": name, "deleted": True})
    else:
        typer.echo(f"{name} deleted")


@workers.command("list")
def list_workers(
    server: ServerOption = None, key: KeyOption = None, as_json: JsonOption = False
) -> None:
    """List the worker slots and what they compute."""
    from chamfer_morph.cli.tables import print_table

    with connect(server, key) as client:
        found = client.workers()
    if as_json:
        print_json({"workers": found})
    else:
        print_table(
            ("worker", "state", "job"), ((each.id, _state(each), each.job or "") for each in found)
        )


@workers.command()
def pause(
    worker: WorkerArgument,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Let a worker finish its job and start no other."""
    with connect(server, key) as client:
        status = client.pause_worker(worker)
    _print_status(status, as_json=as_json)


@workers.command()
def unpause(
    worker: WorkerArgument,
    server: ServerOption = None,
    key: KeyOption = None,
    as_json: JsonOption = False,
) -> None:
    """Let a paused worker start jobs again."""
    with connect(server, key) as client:
        status = client.unpause_worker(worker)
    _print_status(status, as_json=as_json)


def _print_status(status: WorkerStatus, *, as_json: bool) -> None:
    if as_json:
        print_json(status)
    else:
        typer.echo(f"{status.id}  {_state(status)}")


def _state(status: WorkerStatus) -> str:
    if not status.alive:
        return "gone"
    return "paused" if status.paused else "working" if status.job else "idle"
