"""Commands on webhooks: whom the service tells of one's jobs."""

from __future__ import annotations

import time
from itertools import islice
from typing import TYPE_CHECKING, Annotated

import typer

from chamfer_morph.cli.exit_status import JOB_FAILED
from chamfer_morph.cli.option_groups import expand_groups
from chamfer_morph.cli.options import ServiceOptions
from chamfer_morph.cli.tables import local_time, print_table

if TYPE_CHECKING:
    from chamfer_morph.client import MorphClient
    from chamfer_morph.schemas import Delivery

PANEL = "Jobs of the service"
TEST_SECONDS = 30.0
"""How long to wait for the first attempt to deliver a test."""

LOOK_SECONDS = 0.5

app: typer.Typer = typer.Typer()
webhooks: typer.Typer = typer.Typer(
    help="URLs that are told when the state of your jobs changes.", no_args_is_help=True
)
app.add_typer(webhooks, name="webhooks", rich_help_panel=PANEL)

WebhookArgument = Annotated[
    str, typer.Argument(metavar="WEBHOOK", help="Id of a webhook, see morph webhooks list.")
]


@webhooks.command("list")
@expand_groups
def list_webhooks(service: ServiceOptions) -> None:
    """List your webhooks; nobody can see their secrets."""
    with service.connect() as client:
        found = client.webhooks()
    rows = ((each.id, each.url, " ".join(each.states), each.owner) for each in found)
    service.print(
        {"webhooks": found}, lambda: print_table(("webhook", "url", "tells of", "owner"), rows)
    )


@webhooks.command("create")
@expand_groups
def create_webhook(
    url: Annotated[str, typer.Argument(metavar="URL", help="Where to send the messages.")],
    *,
    state: Annotated[
        list[str] | None,
        typer.Option(
            help="queued, running, succeeded, failed, cancelled or timed_out, again and again; "
            "the last four if not given."
        ),
    ] = None,
    secret: Annotated[
        str | None,
        typer.Option(help="What messages are signed with; a new one if not given."),
    ] = None,
    service: ServiceOptions,
) -> None:
    """Have URL told of your jobs; prints the id and the secret, which is not shown again."""
    with service.connect() as client:
        wanted = {"states": state} if state else {}
        webhook = client.create_webhook(url, secret=secret, **wanted)
    service.print(webhook, f"{webhook.id}  {webhook.secret}")
    if not service.as_json:
        typer.echo("Keep the secret: it is not shown again.", err=True)


@webhooks.command("delete")
@expand_groups
def delete_webhook(webhook: WebhookArgument, service: ServiceOptions) -> None:
    """Delete a webhook and its log."""
    with service.connect() as client:
        client.delete_webhook(webhook)
    service.print({"id": webhook, "deleted": True}, f"{webhook} deleted")


@webhooks.command("test")
@expand_groups
def test_webhook(webhook: WebhookArgument, service: ServiceOptions) -> None:
    """Send a test, and show how the first attempt went; exit status 1 if it failed."""
    with service.connect() as client:
        delivery = _attempted(client, webhook, client.test_webhook(webhook))
    service.print(delivery, f"{delivery.id}  {_in_words(delivery)}")
    if delivery.state != "delivered":
        raise typer.Exit(JOB_FAILED)


@webhooks.command("log")
@expand_groups
def show_log(
    webhook: WebhookArgument,
    *,
    limit: Annotated[int, typer.Option(min=1, help="At most so many messages.")] = 20,
    service: ServiceOptions,
) -> None:
    """Show what was sent to a webhook and what became of it, the newest first."""
    with service.connect() as client:
        found = list(islice(client.deliveries(webhook), limit))
    rows = (
        (
            local_time(each.created_at), each.type, each.job or "", each.state,
            str(len(each.attempts)), _last_answer(each),
        )
        for each in found
    )  # fmt: skip
    header = ("time", "message", "job", "state", "attempts", "last answer")
    service.print({"deliveries": found}, lambda: print_table(header, rows))


def _attempted(client: MorphClient, webhook: str, delivery: Delivery) -> Delivery:
    """A delivery after its first attempt, or as it is when that has not come for a while."""
    deadline = time.monotonic() + TEST_SECONDS
    while not delivery.attempts and time.monotonic() < deadline:
        time.sleep(LOOK_SECONDS)
        found = (each for each in client.deliveries(webhook) if each.id == delivery.id)
        delivery = next(found, delivery)
    return delivery


def _in_words(delivery: Delivery) -> str:
    if not delivery.attempts:
        return "not attempted yet; does the janitor of the service run?"
    again = ""
    if delivery.next_attempt_at:
        again = f" It is tried again at {local_time(delivery.next_attempt_at)}."
    return f"{delivery.state}: {_last_answer(delivery)}{again}"


def _last_answer(delivery: Delivery) -> str:
    if not delivery.attempts:
        return ""
    last = delivery.attempts[-1]
    return last.problem or f"status {last.status}"
