"""Following of a job: its events as they happen, through lost connections."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import TypeVar

import httpx
from pydantic import BaseModel, ValidationError

from chamfer_morph.client.connection import Call, Reply, Transport
from chamfer_morph.client.errors import strange_answer
from chamfer_morph.client.event_stream import EventStream
from chamfer_morph.client.retry import PATIENT, Attempts
from chamfer_morph.schemas import Event, EventPage, JobState

Model = TypeVar("Model", bound=BaseModel)

POLL_SECONDS = 1.0

STREAM_TIMEOUT = httpx.Timeout(30.0, read=60.0)
"""A stream says something every so often, if only a comment [s]."""

_TRY_POLLING = {406, 415, 429, 503}


async def follow(transport: Transport, path: str, after: int) -> AsyncGenerator[Event, None]:
    """Events with an id above `after` until the job is finished.

    They are streamed; a lost connection is taken up again after the last event. Where streams do
    not get through, the service is polled.

    Raises:
        ServiceError: There is no such job, or the service stays away.
    """
    for source in (_streamed, _polled):
        async with aclosing(source(transport, path, after)) as events:
            async for event in events:
                after = event.id
                yield event
                if finishes(event):
                    return


def finishes(event: Event) -> bool:
    """Whether nothing comes after this event."""
    return event.type == "state" and JobState(event.data["state"]).finished


async def _streamed(transport: Transport, path: str, after: int) -> AsyncGenerator[Event, None]:
    """Events from stream after stream; ends where there are no streams to be had."""
    attempts = Attempts(transport.server, limit=PATIENT)
    while True:
        silent = True
        try:
            async with transport.open(_stream_call(path, after)) as reply:
                if reply.response.status_code in _TRY_POLLING or _is_something_else(reply):
                    return
                if reply.response.is_error:
                    pause = attempts.pause_after_refusal(reply.response)
                else:
                    stream = EventStream()
                    async for chunk in reply.chunks:
                        silent = False
                        attempts.succeeded()
                        for message in stream.feed(chunk):
                            event = _parsed(transport, Event, message.data)
                            after = event.id
                            yield event
                    pause = attempts.pause_after_loss(EOFError("the event stream broke off"))
        except httpx.ReadTimeout as error:
            if silent:
                return  # something in between keeps the stream back
            pause = attempts.pause_after_loss(error)
        except httpx.TransportError as error:
            pause = attempts.pause_after_loss(error)
        await transport.sleep(pause)


async def _polled(transport: Transport, path: str, after: int) -> AsyncGenerator[Event, None]:
    attempts = Attempts(transport.server, limit=PATIENT)
    while True:
        try:
            response = await transport.send(Call("GET", path, {"after": after}))
            if response.is_success:
                attempts.succeeded()
                page = _parsed(transport, EventPage, response.content)
                for event in page.items:
                    yield event
                if page.state.finished and not page.items:
                    return
                after = page.last_id
                pause = 0.0 if page.items else POLL_SECONDS
            else:
                pause = attempts.pause_after_refusal(response)
        except httpx.TransportError as error:
            pause = attempts.pause_after_loss(error)
        await transport.sleep(pause)


def _stream_call(path: str, after: int) -> Call:
    headers = {"Accept": "text/event-stream"}
    if after:
        headers["Last-Event-ID"] = str(after)
    return Call("GET", path, headers=headers, timeout=STREAM_TIMEOUT)


def _is_something_else(reply: Reply) -> bool:
    kind = reply.response.headers.get("content-type", "")
    return reply.response.is_success and not kind.startswith("text/event-stream")


def _parsed(transport: Transport, model: type[Model], text: str | bytes) -> Model:
    try:
        return model.model_validate_json(text)
    except ValidationError:
        raise strange_answer(transport.server) from None
