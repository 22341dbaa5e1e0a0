"""/v1/queue: the queued jobs of a key, which it may pause."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from chamfer_morph.schemas import JobState, QueueStatus
from chamfer_morph.server.auth import AuthenticatedRoute, Reader, Submitter
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.http.problems import ProblemError

router: APIRouter = APIRouter(prefix="/queue", tags=["queue"], route_class=AuthenticatedRoute)

Owner = Annotated[
    str | None,
    Query(
        max_length=64,
        pattern=r"^[^\x00]*$",
        description="Name of another key whose queue to see or pause; needs an admin key.",
    ),
]


@router.get("", operation_id="getQueue", summary="Show your queue")
def get_queue(caller: Reader, context: Context, owner: Owner = None) -> QueueStatus:
    """How many of your jobs are queued and running, and whether you have paused them."""
    return _show(_owner(owner, caller), context)


@router.post("/pause", operation_id="pauseQueue", summary="Pause your queue")
def pause_queue(caller: Submitter, context: Context, owner: Owner = None) -> QueueStatus:
    """Start no more of your jobs. Running jobs continue, and new ones can be submitted."""
    name = _owner(owner, caller)
    context.queue.pause(name)
    return _show(name, context)


@router.post("/unpause", operation_id="unpauseQueue", summary="Unpause your queue")
def unpause_queue(caller: Submitter, context: Context, owner: Owner = None) -> QueueStatus:
    """Start your jobs again. They queue as if they were submitted now."""
    name = _owner(owner, caller)
    if context.queue.is_paused(name):
        context.queue.unpause(name)
    return _show(name, context)


def _owner(owner: str | None, caller: Caller) -> str:
    """Whose queue is meant.

    Raises:
        ProblemError: 403.
    """
    if owner is None or caller.can_see(owner):
        return caller.name if owner is None else owner
    raise ProblemError(403, "This queue belongs to another key.", "Omit `owner`.")


def _show(owner: str, context: ServerContext) -> QueueStatus:
    counts = context.queue.counts(owner)
    return QueueStatus(
        owner=owner,
        paused=context.queue.is_paused(owner),
        queued=counts[JobState.QUEUED],
        running=counts[JobState.RUNNING],
    )
