"""/v1/workers: which worker slots live, what they do, and pausing them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated

from fastapi import APIRouter, Query

from chamfer_morph.schemas import WorkerStatus
from chamfer_morph.server.auth import Admin, AuthenticatedRoute
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.problems import not_found
from chamfer_morph.worker.locks import living

router: APIRouter = APIRouter(prefix="/workers", tags=["workers"], route_class=AuthenticatedRoute)


@router.get("", operation_id="listWorkers", summary="List worker slots")
def list_workers(
    caller: Admin,
    context: Context,
    limit: Annotated[int, Query(ge=1, le=1000, description="Slots per page.")] = 1000,
    after: Annotated[
        str,
        Query(
            max_length=255, description="Only slots after this one, the last of the previous page."
        ),
    ] = "",
) -> list[WorkerStatus]:
    """The slots that work for this service, and those that ended abnormally, by name.

    Such a slot is forgotten after a day, unless it is paused.
    """
    return [worker for worker in worker_statuses(context) if worker.id > after][:limit]


@router.post("/{worker_id}/pause", operation_id="pauseWorker", summary="Pause a worker slot")
def pause_worker(worker_id: str, caller: Admin, context: Context) -> WorkerStatus:
    """Let a slot finish its job and take no more."""
    return _pause(worker_id, True, context)


@router.post("/{worker_id}/unpause", operation_id="unpauseWorker", summary="Unpause a slot")
def unpause_worker(worker_id: str, caller: Admin, context: Context) -> WorkerStatus:
    """Let a slot take jobs again."""
    return _pause(worker_id, False, context)


def worker_statuses(context: ServerContext) -> list[WorkerStatus]:
    """What each slot does, by name; with those that have ended, and whose jobs nobody has yet."""
    slots, running = context.worker_slots.all(), context.queue.running()
    names = sorted({*slots, *running})
    return _statuses({name: slots.get(name, False) for name in names}, running, context)


def _pause(name: str, paused: bool, context: ServerContext) -> WorkerStatus:
    if name not in context.worker_slots.all():
        raise not_found("worker slot", name)
    context.worker_slots.pause(name, paused)
    return _statuses({name: paused}, context.queue.running(), context)[0]


def _statuses(
    paused: Mapping[str, bool], running: Mapping[str, Collection[str]], context: ServerContext
) -> list[WorkerStatus]:
    """What some slots do, of which it is known whether they are paused, by the running jobs."""
    alive = living(context.settings, context.engine, paused)
    return [
        WorkerStatus(
            id=name,
            alive=name in alive,
            paused=paused[name],
            job=next(iter(running.get(name, ())), None),
        )
        for name in paused
    ]
