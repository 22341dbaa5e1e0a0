"""Webhooks: whom the service tells when the state of a job changes."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from chamfer_morph.schemas.jobs import JobState
from chamfer_morph.schemas.types import Request

DeliveryState = Literal["pending", "delivered", "failed"]
"""Not taken yet, and tried again; taken; given up."""


class WebhookRequest(Request):
    """A new webhook."""

    url: str = Field(
        min_length=1,
        max_length=2000,
        pattern=r"^[\x21-\x7e]+$",
        description="URL to send the messages to, http or https.",
    )
    states: list[Annotated[JobState, Field(strict=False)]] = Field(
        default=[state for state in JobState if state.finished],
        min_length=1,
        description="States of your jobs to be notified of.",
    )
    secret: str | None = Field(
        None,
        max_length=200,
        pattern=r"^whsec_[A-Za-z0-9+/]+=*$",
        description="Secret that messages are signed with: `whsec_` and 24 to 64 bytes in base64. "
        "Default: the service makes one.",
    )


class Webhook(BaseModel):
    """A webhook without its secret."""

    id: str
    url: str
    states: list[JobState]
    owner: str = Field(description="Name of the key whose jobs it reports; empty without keys.")
    created_at: datetime


class NewWebhook(Webhook):
    """A webhook with its secret, shown only once."""

    secret: str


class DeliveryAttempt(BaseModel):
    """One attempt to deliver a message."""

    at: datetime
    seconds: float = Field(description="Duration [s].")
    status: int | None = Field(description="HTTP status of the response, if there was one.")
    problem: str = Field(description="Why it failed; empty if it was delivered.")


class Delivery(BaseModel):
    """A message to a webhook, and its delivery."""

    id: str = Field(description="The `webhook-id` of the message, the same in every attempt.")
    type: str = Field(description="`job.` and the new state of the job, or `test`.")
    job: str | None
    created_at: datetime = Field(description="When the state changed.")
    state: DeliveryState = Field(description="`failed` means that all attempts failed.")
    next_attempt_at: datetime | None = Field(description="Set while it is pending.")
    attempts: list[DeliveryAttempt]


class DeliveryPage(BaseModel):
    """Some messages to a webhook, the newest first."""

    items: list[Delivery]
    next_cursor: str | None
