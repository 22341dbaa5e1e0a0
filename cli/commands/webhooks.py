"""Commands on webhooks: URLs that the service notifies of one's jobs."""

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
    help="URLs that are notified when the state of your jobs changes.", no_args_is_help=True
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
        {"webhooks": found}, lambda: print_table(("webhook", "url", "states", "owner"), rows)
    )


@webhooks.command("create")
@expand_groups
def create_webhook(
    url: Annotated[str, typer.Argument(metavar="URL", help="URL to send the messages to.")],
    *,
    state: Annotated[
        list[str] | None,
        typer.Option(
            help="queued, running, succeeded, failed, cancelled or timed_out; repeat for several. "
            "Default: the last four."
        ),
    ] = None,
    secret: Annotated[
        str | None,
        typer.Option(help="Secret that messages are signed with; default: a new one."),
    ] = None,
    service: ServiceOptions,
) -> None:
    """Notify URL of your jobs; prints the id and the secret, which is not shown again."""
    with service.connect() as client:
        wanted = {"states": state} if state else {}
        webhook = client.create_webhook(url, secret=secret, **wanted)
    service.print(webhook, f"{webhook.id}  {webhook.secret}")
    if not service.as_json:
        typer.echo("Save the secret: it will not be shown again.", err=True)


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
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of messages.")] = 20,
    service: ServiceOptions,
) -> None:
    """Show messages to a webhook and whether they were delivered, the newest first."""
    with service.connect() as client:
        found = list(islice(client.deliveries(webhook), limit))
    rows = (
        (
            local_time(each.created_at), each.type, each.job or "", each.state,
            str(len(each.attempts)), _last_answer(each),
        )
        for each in found
    )  # fmt: skip
    header = ("time", "message", "job", "state", "attempts", "last response")
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
        return "not attempted yet; is the janitor of the service running?"
    again = ""
    if delivery.next_attempt_at:
        again = f" It will be tried again at {local_time(delivery.next_attempt_at)}."
    return f"{delivery.state}: {_last_answer(delivery)}{again}"


def _last_answer(delivery: Delivery) -> str:
    if not delivery.attempts:
        return ""
    last = delivery.attempts[-1]
    return last.problem or f"status {last.status}"
