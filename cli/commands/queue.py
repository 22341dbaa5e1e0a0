"""Commands on one's own queued jobs as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import ServiceOptions

if TYPE_CHECKING:
    from chamfer_morph.schemas import QueueStatus

PANEL = "Jobs of the service"

app: typer.Typer = typer.Typer()
queue: typer.Typer = typer.Typer(help="Your queue of jobs.", no_args_is_help=True)
app.add_typer(queue, name="queue", rich_help_panel=PANEL)


@queue.command()
@expand_groups
def show(service: ServiceOptions) -> None:
    """Show how many of your jobs are queued and running."""
    with service.connect() as client:
        status = client.queue()
    service.print(status, _in_words(status))


@queue.command()
@expand_groups
def pause(service: ServiceOptions) -> None:
    """Start no more of your jobs; running ones continue."""
    with service.connect() as client:
        status = client.pause_queue()
    service.print(status, _in_words(status))


@queue.command()
@expand_groups
def unpause(service: ServiceOptions) -> None:
    """Start your jobs again."""
    with service.connect() as client:
        status = client.unpause_queue()
    service.print(status, _in_words(status))


def _in_words(status: QueueStatus) -> str:
    paused = ", paused" if status.paused else ""
    return f"{status.queued} queued{paused}; {status.running} running"
