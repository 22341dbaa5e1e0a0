"""Commands on the service itself: API keys and workers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import ServiceOptions
from chamfer_morph.cli.tables import print_table

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
@expand_groups
def list_keys(service: ServiceOptions) -> None:
    """List the API keys; nobody can see their secrets."""
    with service.connect() as client:
        found = client.keys()
    rows = ((each.name, " ".join(each.scopes), f"{each.created_at:%Y-%m-%d}") for each in found)
    service.print({"keys": found}, lambda: print_table(("key", "may", "since"), rows))


@keys.command("create")
@expand_groups
def create_key(
    name: NameArgument,
    *,
    scope: Annotated[
        list[str] | None,
        typer.Option(help="read, submit or admin; repeat for several. Default: read and submit."),
    ] = None,
    service: ServiceOptions,
) -> None:
    """Make an API key; prints its secret, which will not be shown again."""
    with service.connect() as client:
        key = client.create_key(name, scope or ("read", "submit"))
    service.print(key, key.secret)
    if not service.as_json:
        typer.echo("Save it: it will not be shown again.", err=True)


@keys.command("delete")
@expand_groups
def delete_key(name: NameArgument, service: ServiceOptions) -> None:
    """Delete an API key; it stops working at once."""
    with service.connect() as client:
        client.delete_key(name)
    service.print({"name": name, "deleted": True}, f"{name} deleted")


@workers.command("list")
@expand_groups
def list_workers(service: ServiceOptions) -> None:
    """List the worker slots and what they compute."""
    with service.connect() as client:
        found = client.workers()
    rows = ((each.id, _state(each), each.job or "") for each in found)
    service.print({"workers": found}, lambda: print_table(("worker", "state", "job"), rows))


@workers.command()
@expand_groups
def pause(worker: WorkerArgument, service: ServiceOptions) -> None:
    """Let a worker finish its job and start no more."""
    with service.connect() as client:
        status = client.pause_worker(worker)
    service.print(status, f"{status.id}  {_state(status)}")


@workers.command()
@expand_groups
def unpause(worker: WorkerArgument, service: ServiceOptions) -> None:
    """Let a paused worker start jobs again."""
    with service.connect() as client:
        status = client.unpause_worker(worker)
    service.print(status, f"{status.id}  {_state(status)}")


def _state(status: WorkerStatus) -> str:
    if not status.alive:
        return "gone"
    return "paused" if status.paused else "working" if status.job else "idle"
