"""/v1/jobs/{id}/events: what happens to a job, as a stream or by polling."""

from __future__ import annotations

from typing import Annotated, Any

import anyio
from fastapi import APIRouter, Header, Query, Request
from fastapi.sse import EventSourceResponse
from starlette.types import Receive, Scope, Send

from chamfer_morph.schemas import EventPage
from chamfer_morph.server.auth import AuthenticatedRoute, JobReader
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.event_hub import Subscription
from chamfer_morph.server.routes.job_lookup import VisibleJob
from chamfer_morph.worker.job_record import JobRecord

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}", tags=["events"], route_class=AuthenticatedRoute
)

SSE = "text/event-stream"
LARGEST_ID = 2**53


class EventStream(EventSourceResponse):
    """Events until the job rests or the client leaves, be that before the first of them."""

    def __init__(self, subscription: Subscription, after: int) -> None:
        headers = {"Cache-Control": "no-cache", "X-Accel-Buffering": "no"}
        super().__init__(subscription.events(after), headers=headers)
        self._subscription = subscription

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, and give the place back that the stream has taken."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._subscription.hub.unsubscribe(self._subscription)


@router.get(
    "/events",
    operation_id="getEvents",
    summary="Events of a job",
    response_model=EventPage,
    responses={
        200: {
            "content": {SSE: {"schema": {"type": "string"}}},
            "description": "A page, or a stream with `Accept: text/event-stream`.",
        }
    },
)
async def get_events(
    job: VisibleJob,
    request: Request,
    caller: JobReader,
    context: Context,
    after: Annotated[
        int, Query(ge=0, le=LARGEST_ID, description="Only events with a larger id.")
    ] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="Events per page.")] = 100,
    last_event_id: Annotated[
        str | None, Header(description="Like `after`; browsers send it when they reconnect.")
    ] = None,
) -> Any:
    """Attempts, finished frames, steps of the watchdog, problems and changes of state.

    With `Accept: text/event-stream` they come as server-sent events as they happen, each with the
    same JSON as in a page; the stream ends once the job has ended, after a last `state` event. An
    interrupted stream can be resumed with `Last-Event-ID`.
    """
    if last_event_id is not None and last_event_id.isascii() and last_event_id.isdigit():
        after = max(after, min(int(last_event_id[:17]), LARGEST_ID))
    if accepts_stream(request.headers.get("accept", "")):
        return EventStream(context.event_hub.subscribe(job, caller), after)
    return await anyio.to_thread.run_sync(_page, job, after, limit, context)


def accepts_stream(accept: str) -> bool:
    """Whether an Accept header asks for server-sent events."""
    return any(part.partition(";")[0].strip().lower() == SSE for part in accept.split(","))


def _page(job: JobRecord, after: int, limit: int, context: ServerContext) -> EventPage:
    """Events of the log; the state was read before, so a final one has all its events."""
    items = context.storage.events(job.id).read(after, limit)
    return EventPage(items=items, last_id=items[-1].id if items else after, state=job.state)
