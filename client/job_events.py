"""Following of a job: its events as they happen, through lost connections."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import aclosing

import httpx
from anyio import sleep
from httpx_sse import EventSource

from chamfer_morph.client.connection import Connection
from chamfer_morph.client.retry import MANY_ATTEMPTS, Attempts
from chamfer_morph.schemas import Event, EventPage, JobState

POLL_SECONDS = 1.0

STREAM_TIMEOUT = httpx.Timeout(30.0, read=60.0)
"""A stream sends something every so often, if only a comment [s]."""

_TRY_POLLING = {406, 415, 429, 503}


async def follow(connection: Connection, path: str, after: int) -> AsyncGenerator[Event, None]:
    """Events with an id above `after` until the job is finished.

    They are streamed; a lost connection is taken up again after the last event. Where streams do
    not get through, the service is polled.

    Raises:
        ServiceError: There is no such job, or the service stays away.
    """
    for source in (_stream, _poll):
        async with aclosing(source(connection, path, after)) as events:
            async for event in events:
                after = event.id
                yield event
                if event.type == "state" and JobState(event.data["state"]).finished:
                    return


async def _stream(connection: Connection, path: str, after: int) -> AsyncGenerator[Event, None]:
    """Events from stream after stream; ends where there are no streams to be had."""
    attempts = Attempts(connection.server, limit=MANY_ATTEMPTS)
    while True:
        headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": str(after)} if after else {})
        response: httpx.Response | None = None
        loss: Exception = EOFError("the event stream was interrupted")
        try:
            async with connection.stream(path, headers=headers, timeout=STREAM_TIMEOUT) as response:
                if response.status_code in _TRY_POLLING or _is_no_event_stream(response):
                    return
                if response.is_success:
                    async for message in EventSource(response).aiter_sse():
                        if message.data:
                            event = connection.parse(Event, message.data)
                            after = event.id
                            yield event
        except httpx.TransportError as error:
            loss = error
        if response is not None and not response.is_success:
            await attempts.pause_after_refusal(response)
            continue
        if response is not None and response.num_bytes_downloaded:
            attempts.succeeded()  # comments show as well as events that the stream gets through
        elif isinstance(loss, httpx.ReadTimeout):
            return  # something in between keeps the stream back
        await attempts.pause_after_loss(loss)


async def _poll(connection: Connection, path: str, after: int) -> AsyncGenerator[Event, None]:
    while True:
        response = await connection.get(path, after=after, wait_for_service=True)
        page = connection.parse(EventPage, response.content)
        for event in page.items:
            yield event
        if page.state.finished and not page.items:
            return
        after = page.last_id
        if not page.items:
            await sleep(POLL_SECONDS)


def _is_no_event_stream(response: httpx.Response) -> bool:
    kind = response.headers.get("content-type", "")
    return response.is_success and not kind.startswith("text/event-stream")
