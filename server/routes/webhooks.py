"""/v1/webhooks: make, list, test and delete webhooks, and what became of their messages."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated

import anyio.from_thread
from fastapi import APIRouter, Body, Depends, Response
from fastapi.openapi.models import Example

from chamfer_morph.schemas import Delivery, DeliveryPage, NewWebhook, Webhook, WebhookRequest
from chamfer_morph.schemas.ids import is_id
from chamfer_morph.server.auth import AuthenticatedRoute, Reader, Submitter, key_revoked
from chamfer_morph.server.context import Context
from chamfer_morph.server.http import cursors
from chamfer_morph.server.http.problems import not_found
from chamfer_morph.worker.webhooks.signature import check_secret, new_secret
from chamfer_morph.worker.webhooks.targets import HostNotFoundError, parse_url, port_of, resolve

router: APIRouter = APIRouter(prefix="/webhooks", tags=["webhooks"], route_class=AuthenticatedRoute)

EXAMPLES: dict[str, Example] = {
    "ended": {
        "summary": "Notify when a job ends",
        "value": {"url": "https://example.com/morph"},
    }
}


def _find_webhook(webhook_id: str, caller: Reader, context: Context) -> Webhook:
    """A webhook that the caller may see.

    Raises:
        ProblemError: 404.
    """
    found = context.webhooks.get(webhook_id) if is_id(webhook_id) else None
    if found is None or not caller.can_see(found.owner):
        raise not_found("webhook", webhook_id)
    return found


VisibleWebhook = Annotated[Webhook, Depends(_find_webhook)]


@router.get("", operation_id="listWebhooks", summary="List webhooks")
def list_webhooks(caller: Reader, context: Context) -> list[Webhook]:
    """Your webhooks without their secrets, the oldest first; everybody's for an admin key."""
    return context.webhooks.all(caller.owner_filter)


@router.post("", status_code=201, operation_id="makeWebhook", summary="Make a webhook")
def make_webhook(
    caller: Submitter,
    body: Annotated[WebhookRequest, Body(openapi_examples=EXAMPLES)],
    response: Response,
    context: Context,
) -> NewWebhook:
    """Be notified when jobs of this key enter certain states. The secret is shown only once.

    The address has to be public, unless an administrator of the service has allowed its network.
    """
    url = parse_url(body.url)
    secret = new_secret() if body.secret is None else body.secret
    check_secret(secret)
    allowed = context.settings.allowed_webhook_networks
    with suppress(HostNotFoundError):  # it may be found by the time there is something to tell
        anyio.from_thread.run(resolve, url.host, port_of(url), allowed)
    with context.quotas.letting_in_webhook(
        caller.name, lambda: context.webhooks.count(caller.name)
    ):
        webhook = context.webhooks.add(caller.name, body.url, body.states, secret)
        if context.is_revoked(caller):
            context.webhooks.remove(webhook.id)
            raise key_revoked()
    response.headers["Location"] = f"/v1/webhooks/{webhook.id}"
    return NewWebhook(**webhook.model_dump(), secret=secret)


@router.get("/{webhook_id}", operation_id="getWebhook", summary="Show a webhook")
def get_webhook(webhook: VisibleWebhook) -> Webhook:
    """A webhook without its secret."""
    return webhook


@router.delete(
    "/{webhook_id}", status_code=204, operation_id="deleteWebhook", summary="Delete a webhook"
)
def delete_webhook(caller: Submitter, webhook: VisibleWebhook, context: Context) -> None:
    """Stop sending messages to it, and delete the log of those sent."""
    context.webhooks.remove(webhook.id)


@router.post(
    "/{webhook_id}/test", status_code=202, operation_id="testWebhook", summary="Test a webhook"
)
def try_webhook(caller: Submitter, webhook: VisibleWebhook, context: Context) -> Delivery:
    """Send a message of the type `test`; the deliveries tell whether it arrived."""
    with context.quotas.letting_in_test(
        webhook.id, lambda: context.webhooks.pending_tests(webhook.id)
    ):
        test = context.webhooks.add_test(webhook.id)
    if test is None:
        raise not_found("webhook", webhook.id)
    return test


@router.get(
    "/{webhook_id}/deliveries", operation_id="listDeliveries", summary="List its deliveries"
)
def list_deliveries(
    caller: Reader,
    webhook: VisibleWebhook,
    context: Context,
    limit: cursors.Limit = 50,
    cursor: cursors.Cursor = None,
) -> DeliveryPage:
    """Messages of the last 30 days and every attempt to deliver them, the newest first."""
    before = cursors.decode_cursor(cursor)
    found = context.webhooks.deliveries(webhook.id, before=before, limit=limit + 1)
    page, more = found[:limit], len(found) > limit
    return DeliveryPage(
        items=[delivery for _, delivery in page],
        next_cursor=cursors.encode_cursor(*page[-1][0]) if more else None,
    )
