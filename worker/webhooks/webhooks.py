"""Webhooks and the messages to them, in the database of the queue."""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import sqlalchemy as sa
from pydantic import TypeAdapter

from chamfer_morph.schemas import Delivery, DeliveryAttempt, JobState, Webhook
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.worker.tables import create_missing

DAY_MS = 86_400_000

KEPT_DAYS = 30
"""After this a message that was delivered or given up is forgotten."""

_WEBHOOKS = sa.Table(
    "morph_webhooks",
    sa.MetaData(),
    sa.Column("id", sa.String(26), primary_key=True),
    sa.Column("owner", sa.String(64), nullable=False, index=True),
    sa.Column("url", sa.String(2000), nullable=False),
    sa.Column("states", sa.String(200), nullable=False),
    sa.Column("secret", sa.String(200), nullable=False),
    sa.Column("created_at", sa.BigInteger, nullable=False),
)
"""The states with spaces between them; all times in milliseconds since 1970."""

_MESSAGES = sa.Table(
    "morph_webhook_messages",
    sa.MetaData(),
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("webhook", sa.String(26), nullable=False),
    sa.Column("type", sa.String(32), nullable=False),
    sa.Column("job", sa.String(26)),
    sa.Column("created_at", sa.BigInteger, nullable=False),
    sa.Column("due_at", sa.BigInteger, index=True),
    sa.Column("delivered", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Column("attempts", sa.JSON, nullable=False, server_default="[]"),
)
"""`due_at` is when to attempt it next; null once it is delivered or given up."""

_ATTEMPTS = sa.cast(_MESSAGES.c.attempts, sa.Text).label("attempts")
_MESSAGE_COLUMNS = [*(column for column in _MESSAGES.c if column.name != "attempts"), _ATTEMPTS]
"""The attempts as text: one that is damaged must not keep the others from being read."""

_ATTEMPTS_TYPE = TypeAdapter(list[DeliveryAttempt])

_log = logging.getLogger(__name__)

sa.Index("morph_webhook_messages_by_age", _MESSAGES.c.webhook, _MESSAGES.c.created_at)


@dataclass(frozen=True)
class Message:
    """A message that is due.

    Attributes:
        id: Its id, the same in every attempt.
        webhook: Id of the webhook.
        url: Where it goes.
        secret: What it is signed with.
        type: `job.` and the new state, or `test`.
        job: Id of the job, if it is about one.
        created_at: When the state changed.
        attempts: How many attempts there were.
        due_at: When it was due [ms since 1970].
    """

    id: str
    webhook: str
    url: str
    secret: str
    type: str
    job: str | None
    created_at: datetime
    attempts: int
    due_at: int


class Webhooks:
    """The tables. Calls block; an `owner` of None means everybody.

    Args:
        engine: The database of the queue.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    @staticmethod
    def create_tables(engine: sa.Engine) -> None:
        """Create what is missing."""
        create_missing(engine, _WEBHOOKS, _MESSAGES)

    def add(self, owner: str, url: str, states: Collection[JobState], secret: str) -> Webhook:
        """Make a webhook."""
        row = {
            "id": new_id(),
            "owner": owner,
            "url": url,
            "states": " ".join(state.value for state in JobState if state in states),
            "secret": secret,
            "created_at": _now(),
        }
        with self._engine.begin() as connection:
            connection.execute(sa.insert(_WEBHOOKS).values(row))
        return _webhook(row)

    def all(self, owner: str | None) -> list[Webhook]:
        """The webhooks of an owner, the oldest first."""
        c = _WEBHOOKS.c
        query = sa.select(_WEBHOOKS).order_by(c.created_at, c.id)
        if owner is not None:
            query = query.where(c.owner == owner)
        with self._engine.connect() as connection:
            return [_webhook(row) for row in connection.execute(query).mappings()]

    def get(self, webhook_id: str) -> Webhook | None:
        """A webhook, or None."""
        query = sa.select(_WEBHOOKS).where(_WEBHOOKS.c.id == webhook_id)
        with self._engine.connect() as connection:
            row = connection.execute(query).mappings().one_or_none()
        return _webhook(row) if row else None

    def count(self, owner: str) -> int:
        """How many webhooks an owner has."""
        query = sa.select(sa.func.count()).where(_WEBHOOKS.c.owner == owner)
        with self._engine.connect() as connection:
            return int(connection.execute(query).scalar_one())

    def remove(self, webhook_id: str) -> None:
        """Forget a webhook and all messages to it."""
        with self._engine.begin() as connection:
            connection.execute(sa.delete(_WEBHOOKS).where(_WEBHOOKS.c.id == webhook_id))
            connection.execute(sa.delete(_MESSAGES).where(_MESSAGES.c.webhook == webhook_id))

    def remove_of(self, owner: str) -> None:
        """Forget all webhooks of an owner."""
        for webhook in self.all(owner):
            self.remove(webhook.id)

    def add_test(self, webhook_id: str) -> Delivery | None:
        """A message of the type `test`, to be sent at once; None if there is no such webhook."""
        now = _now()
        row = {
            "id": uuid.uuid4().hex,
            "webhook": webhook_id,
            "type": "test",
            "created_at": now,
            "due_at": now,
        }
        # with the webhook, which may be deleted at this moment
        values = sa.select(*map(sa.literal, row.values())).where(
            sa.exists().where(_WEBHOOKS.c.id == webhook_id)
        )
        insert = sa.insert(_MESSAGES).from_select([*row], values).returning(_MESSAGES.c.id)
        with self._engine.begin() as connection:
            if connection.execute(insert).first() is None:
                return None
        return _delivery(row | {"job": None, "delivered": False, "attempts": "[]"})

    def pending_tests(self, webhook_id: str) -> int:
        """How many tests of a webhook are neither delivered nor given up."""
        c = _MESSAGES.c
        pending = (c.webhook == webhook_id) & (c.type == "test") & c.due_at.is_not(None)
        with self._engine.connect() as connection:
            return int(connection.execute(sa.select(sa.func.count()).where(pending)).scalar_one())

    def deliveries(
        self, webhook_id: str, *, before: tuple[int, str] | None, limit: int
    ) -> list[tuple[tuple[int, str], Delivery]]:
        """Messages to a webhook, the newest first, each with its place in the list.

        Args:
            webhook_id: The webhook.
            before: Only those behind this place.
            limit: At most so many.
        """
        c = _MESSAGES.c
        query = sa.select(*_MESSAGE_COLUMNS).where(c.webhook == webhook_id)
        if before is not None:
            query = query.where(sa.tuple_(c.created_at, c.id) < before)
        query = query.order_by(c.created_at.desc(), c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            rows = connection.execute(query).mappings().all()
        return [((row["created_at"], row["id"]), _delivery(row)) for row in rows]

    def due(self, busy: Collection[str], limit: int) -> list[Message]:
        """Messages that are due, one of each webhook.

        Args:
            busy: Webhooks that are left out.
            limit: At most so many.
        """
        c = _MESSAGES.c
        first = (
            sa.select(c.webhook, sa.func.min(c.due_at).label("due_at"))
            .join(_WEBHOOKS, _WEBHOOKS.c.id == c.webhook)
            .where(c.due_at <= _now(), c.webhook.not_in(list(busy)))
            .group_by(c.webhook)
            .order_by("due_at")
            .limit(limit)
            .subquery()
        )
        query = (
            sa.select(*_MESSAGE_COLUMNS, _WEBHOOKS.c.url, _WEBHOOKS.c.secret)
            .join(first, (c.webhook == first.c.webhook) & (c.due_at == first.c.due_at))
            .join(_WEBHOOKS, _WEBHOOKS.c.id == c.webhook)
            .order_by(c.due_at, c.id)
        )
        with self._engine.connect() as connection:
            rows = connection.execute(query).mappings().all()
        return list({row["webhook"]: _message(row) for row in reversed(rows)}.values())

    def claim(self, message: Message, seconds: float) -> bool:
        """Keep other processes away from a message for so long [s]; False if one was quicker."""
        c = _MESSAGES.c
        mine = (c.id == message.id) & (c.due_at == message.due_at)
        later = _now() + round(seconds * 1000)
        with self._engine.begin() as connection:
            change = sa.update(_MESSAGES).where(mine).values(due_at=later)
            return bool(connection.execute(change).rowcount)

    def record(
        self, message: Message, attempt: DeliveryAttempt, again_after_seconds: float | None
    ) -> None:
        """Note how an attempt went, and when there is to be another [s]; None for never."""
        c = _MESSAGES.c
        due = None if again_after_seconds is None else _now() + round(again_after_seconds * 1000)
        with self._engine.begin() as connection:
            query = sa.select(c.id, _ATTEMPTS).where(c.id == message.id).with_for_update()
            row = connection.execute(query).mappings().one_or_none()
            if row is None:  # the webhook has been deleted meanwhile
                return
            attempts = [*_attempts(row), attempt]
            values = {
                "attempts": [each.model_dump(mode="json") for each in attempts],
                "delivered": not attempt.problem,
                "due_at": due,
            }
            connection.execute(sa.update(_MESSAGES).where(c.id == message.id).values(values))

    def forget_old(self) -> None:
        """Forget messages that were delivered or given up long ago, and those to no webhook.

        A job that changes its state while a webhook is deleted may leave such a message.
        """
        c = _MESSAGES.c
        old = c.created_at < _now() - KEPT_DAYS * DAY_MS
        lost = ~sa.exists().where(_WEBHOOKS.c.id == c.webhook)
        with self._engine.begin() as connection:
            connection.execute(sa.delete(_MESSAGES).where(c.due_at.is_(None) & old | lost))


def _webhook(row: Any) -> Webhook:
    return Webhook(
        id=row["id"],
        url=row["url"],
        states=[state for state in JobState if state.value in row["states"].split()],
        owner=row["owner"],
        created_at=_time(row["created_at"]),
    )


def _message(row: Any) -> Message:
    return Message(
        id=row["id"],
        webhook=row["webhook"],
        url=row["url"],
        secret=row["secret"],
        type=row["type"],
        job=row["job"],
        created_at=_time(row["created_at"]),
        attempts=len(_attempts(row)),
        due_at=row["due_at"],
    )


def _delivery(row: Any) -> Delivery:
    pending = row["due_at"] is not None
    return Delivery(
        id=row["id"],
        type=row["type"],
        job=row["job"],
        created_at=_time(row["created_at"]),
        state="pending" if pending else "delivered" if row["delivered"] else "failed",
        next_attempt_at=_time(row["due_at"]) if pending else None,
        attempts=_attempts(row),
    )


def _attempts(row: Any) -> list[DeliveryAttempt]:
    """The attempts to deliver a message; none where they cannot be read."""
    try:
        return _ATTEMPTS_TYPE.validate_json(row["attempts"])
    except ValueError:
        _log.warning("the attempts of message %s cannot be read", row["id"])
        return []


def _now() -> int:
    return round(time.time() * 1000)


def _time(milliseconds: int) -> datetime:
    return datetime.fromtimestamp(milliseconds / 1000, timezone.utc)
