"""Sends messages to webhooks, at least once each: in a thread of the janitor."""

from __future__ import annotations

import asyncio
import json
import logging
import random
import ssl
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timezone
from importlib import metadata

import anyio
import httpcore
import sqlalchemy as sa

from chamfer_morph.schemas import DeliveryAttempt
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.webhooks.signature import sign
from chamfer_morph.worker.webhooks.targets import CheckedNetwork, parse_url, port_of
from chamfer_morph.worker.webhooks.webhooks import Message, Webhooks
from morph_engine.errors import MorphError

ANSWER_SECONDS = 15.0
"""Time to connect, send and have an answer."""

CLAIM_SECONDS = 60.0
"""A message that a process was killed with is attempted again after so long."""

POLL_SECONDS = 1.0

AT_ONCE = 32
"""Messages under way at the same time, one to each webhook."""

GROWTH = 3
"""Each pause between two attempts is so many times the one before, give or take a half."""

log: logging.Logger = logging.getLogger(__name__)


def start(settings: Settings) -> threading.Thread:
    """Send messages in a thread, as long as this process lives."""
    thread = threading.Thread(target=_run, args=(settings,), name="webhooks", daemon=True)
    thread.start()
    return thread


def _run(settings: Settings) -> None:
    while True:
        try:
            anyio.run(deliver_forever, settings)
        except Exception:  # nothing may end it
            log.exception("webhooks failed and will be tried again")
            time.sleep(POLL_SECONDS)


async def deliver_forever(settings: Settings) -> None:
    """Send messages as they come due."""
    # names that are never found take a thread each, and others are not to wait for them
    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(AT_ONCE))
    webhooks = Webhooks(database(settings, kept=1))
    busy: set[str] = set()
    ended = anyio.Event()

    async def deliver(message: Message) -> None:
        nonlocal ended
        try:
            await _deliver(message, webhooks, pool, settings)
        except sa.exc.DBAPIError:  # the database is away; the message is still in it
            log.warning("the outcome of a webhook message could not be recorded", exc_info=True)
        finally:
            busy.discard(message.webhook)
            ended.set()

    async with (
        httpcore.AsyncConnectionPool(
            max_connections=AT_ONCE,
            ssl_context=ssl.create_default_context(),
            max_keepalive_connections=0,
            network_backend=CheckedNetwork(settings.allowed_webhook_networks),
        ) as pool,
        anyio.create_task_group() as tasks,
    ):
        while True:
            ended = anyio.Event()
            room = AT_ONCE - len(busy)
            try:
                due = await anyio.to_thread.run_sync(webhooks.due, busy, room) if room else []
            except sa.exc.DBAPIError as error:
                log.warning("webhook messages cannot be read (%s)", error.orig)
                due = []
            for message in due:
                busy.add(message.webhook)
                tasks.start_soon(deliver, message)
            with anyio.move_on_after(POLL_SECONDS):
                await ended.wait()


async def _deliver(
    message: Message, webhooks: Webhooks, pool: httpcore.AsyncConnectionPool, settings: Settings
) -> None:
    """Attempt a message, unless another process does, and note how that went."""
    if not await anyio.to_thread.run_sync(webhooks.claim, message, CLAIM_SECONDS):
        return
    begun = datetime.now(timezone.utc)
    clock = time.monotonic()
    status, problem = await _send(message, pool)
    attempt = DeliveryAttempt(
        at=begun, seconds=round(time.monotonic() - clock, 3), status=status, problem=problem
    )
    pause = None
    if problem and message.attempts + 1 < settings.webhook_attempts:
        pause = settings.webhook_retry_seconds * GROWTH**message.attempts
        pause *= random.uniform(0.5, 1.5)
    await anyio.to_thread.run_sync(webhooks.record, message, attempt, pause)


async def _send(message: Message, pool: httpcore.AsyncConnectionPool) -> tuple[int | None, str]:
    """Send a message once; the body of the answer is not read, and no redirect followed.

    Returns:
        HTTP status, None if no answer came, and why it failed, empty if it did not.
    """
    body = payload(message)
    timestamp = int(time.time())
    try:
        url = parse_url(message.url)
        with anyio.fail_after(ANSWER_SECONDS):
            async with pool.stream(
                b"POST",
                httpcore.URL(
                    scheme=url.raw_scheme, host=url.raw_host, port=port_of(url), target=url.raw_path
                ),
                headers={
                    "Host": url.netloc,
                    "Content-Type": "application/json",
                    "Content-Length": str(len(body)),
                    "User-Agent": f"chamfer-morph/{metadata.version('chamfer-morph')}",
                    "webhook-id": message.id,
                    "webhook-timestamp": str(timestamp),
                    "webhook-signature": sign(message.secret, message.id, timestamp, body),
                },
                content=body,
            ) as answer:
                status = int(answer.status)
    except TimeoutError:
        return None, f"No response within {ANSWER_SECONDS:g} s."
    except MorphError as error:
        return None, error.cause
    except Exception as error:  # whatever a stranger's server brings about
        return None, f"The request failed ({str(error) or type(error).__name__})."
    return status, "" if 200 <= status < 300 else f"The response has the status {status}."


def payload(message: Message) -> bytes:
    """What is sent, the same in every attempt."""
    data = {"job": message.job, "state": message.type.removeprefix("job.")} if message.job else {}
    document = {"type": message.type, "timestamp": message.created_at.isoformat(), "data": data}
    return json.dumps(document, separators=(",", ":")).encode()
