"""/v1/workers: which worker slots live, what they do, and pausing them."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from fastapi import APIRouter

from chamfer_morph.schemas import WorkerStatus
from chamfer_morph.server.auth import Admin, AuthenticatedRoute
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.problems import not_found
from chamfer_morph.worker import slots
from chamfer_morph.worker.locks import try_lock

router: APIRouter = APIRouter(prefix="/workers", tags=["workers"], route_class=AuthenticatedRoute)


@router.get("", operation_id="listWorkers", summary="List worker slots")
def list_workers(caller: Admin, context: Context) -> list[WorkerStatus]:
    """All slots that have ever worked on this storage."""
    return worker_statuses(context)


@router.post("/{worker_id}/pause", operation_id="pauseWorker", summary="Pause a worker slot")
def pause_worker(worker_id: str, caller: Admin, context: Context) -> WorkerStatus:
    """Let a slot finish its job and take no other."""
    _check(worker_id, context)
    slots.pause(context.settings.data_dir, worker_id)
    return _show(worker_id, context.queue.running(), context)


@router.post("/{worker_id}/unpause", operation_id="unpauseWorker", summary="Unpause a slot")
def unpause_worker(worker_id: str, caller: Admin, context: Context) -> WorkerStatus:
    """Let a slot take jobs again."""
    _check(worker_id, context)
    slots.unpause(context.settings.data_dir, worker_id)
    return _show(worker_id, context.queue.running(), context)


def worker_statuses(context: ServerContext) -> list[WorkerStatus]:
    """What each slot does."""
    running = context.queue.running()
    return [_show(name, running, context) for name in slots.names(context.settings.data_dir)]


def _check(worker_id: str, context: ServerContext) -> None:
    if worker_id not in slots.names(context.settings.data_dir):
        raise not_found("worker slot", worker_id)


def _show(
    name: str, running: Mapping[str, Collection[str]], context: ServerContext
) -> WorkerStatus:
    lock = try_lock(context.settings, name)
    if lock is not None:
        lock.release()
    return WorkerStatus(
        id=name,
        alive=lock is None,
        paused=slots.is_paused(context.settings.data_dir, name),
        job=next(iter(running.get(name, ())), None),
    )
