"""/v1/workers: which worker slots live, what they do, and pausing them."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import APIRouter

from chamfer_morph.schemas import WorkerStatus
from chamfer_morph.server.auth import Admin, AuthenticatedRoute
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.problems import not_found
from chamfer_morph.worker.locks import living

router: APIRouter = APIRouter(prefix="/workers", tags=["workers"], route_class=AuthenticatedRoute)


@router.get("", operation_id="listWorkers", summary="List worker slots")
def list_workers(caller: Admin, context: Context) -> list[WorkerStatus]:
    """All slots that have ever worked for this service."""
    return worker_statuses(context)


@router.post("/{worker_id}/pause", operation_id="pauseWorker", summary="Pause a worker slot")
def pause_worker(worker_id: str, caller: Admin, context: Context) -> WorkerStatus:
    """Let a slot finish its job and take no other."""
    return _pause(worker_id, True, context)


@router.post("/{worker_id}/unpause", operation_id="unpauseWorker", summary="Unpause a slot")
def unpause_worker(worker_id: str, caller: Admin, context: Context) -> WorkerStatus:
    """Let a slot take jobs again."""
    return _pause(worker_id, False, context)


def worker_statuses(context: ServerContext) -> list[WorkerStatus]:
    """What each slot does."""
    return _statuses(context.worker_slots.all(), context)


def _pause(name: str, paused: bool, context: ServerContext) -> WorkerStatus:
    if name not in context.worker_slots.all():
        raise not_found("worker slot", name)
    context.worker_slots.pause(name, paused)
    return _statuses({name: paused}, context)[0]


def _statuses(paused: Mapping[str, bool], context: ServerContext) -> list[WorkerStatus]:
    """What some slots do, of which it is known whether they are paused."""
    running = context.queue.running()
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
