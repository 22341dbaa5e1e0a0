"""The command on share links: let others see a job without a key."""

from __future__ import annotations

from typing import Annotated

import typer

from chamfer_morph.cli.commands.jobs import PANEL, JobArgument
from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import ServiceOptions
from chamfer_morph.cli.tables import local_time, print_table
from morph_engine.errors import ConfigError

app: typer.Typer = typer.Typer()


@app.command(rich_help_panel=PANEL)
@expand_groups
def share(
    job_id: JobArgument,
    *,
    show: Annotated[
        bool, typer.Option("--list", help="List the existing links instead of making one.")
    ] = False,
    revoke: Annotated[bool, typer.Option("--revoke", help="Revoke all links of the job.")] = False,
    revoke_link: Annotated[
        str | None, typer.Option(metavar="LINK", help="Revoke one link by its id.")
    ] = None,
    service: ServiceOptions,
) -> None:
    """Make a link that shows a job to others without a key; its URL is printed only once."""
    if show + revoke + (revoke_link is not None) > 1:
        raise ConfigError(
            "--list, --revoke and --revoke-link cannot be combined.",
            "Use only one of them.",
        )
    with service.connect() as client:
        if revoke or revoke_link:
            ids = [revoke_link] if revoke_link else [link.id for link in client.share_links(job_id)]
            for link_id in ids:
                client.revoke_share_link(job_id, link_id)
            text = "\n".join(f"{link_id} revoked" for link_id in ids) or "There are no links."
            return service.print({"job": job_id, "revoked": ids}, text)
        if show:
            links = client.share_links(job_id)
            rows = [(link.id, local_time(link.created_at)) for link in links]
            return service.print({"links": links}, lambda: print_table(("link", "made"), rows))
        link = client.share(job_id)
        url = f"{client.server}{link.path}"
    service.print(link.model_dump(mode="json") | {"url": url}, url)
