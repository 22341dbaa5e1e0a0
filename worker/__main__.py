"""Processes of the worker: `python -m chamfer_morph.worker run | janitor | adopt | alive`."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, NoReturn

import sqlalchemy as sa

from chamfer_morph.worker import liveness, service_log, telemetry
from chamfer_morph.worker.exit_codes import ExitCode
from chamfer_morph.worker.private_process import keep_private
from chamfer_morph.worker.settings import Settings, load_settings
from chamfer_morph.worker.slots import WorkerSlots, executor_id, janitor_id
from morph_engine.errors import ConfigError, MorphError

if TYPE_CHECKING:
    from chamfer_morph.worker.queue import JobQueue
    from chamfer_morph.worker.storage import Storage

log: logging.Logger = logging.getLogger("chamfer_morph.worker")

POLL_SECONDS = 0.05
LOCK_CHECK_SECONDS = 4.0
NEWS_SECONDS = 0.5
ADOPTION_LIMIT_SECONDS = 60
LOCK_TIMEOUT_SECONDS = 10.0
"""A worker that comes back waits so long for a janitor that adopts its jobs under its name."""


def main() -> None:
    """Run one process until it is told to end."""
    arguments = _parser().parse_args()
    keep_private()
    try:
        settings = load_settings()
        service_log.set_up(settings.log_format)
        _run(arguments, settings)
    except MorphError as error:
        refuse(error.cause, error.remedy, ExitCode.REFUSED if isinstance(error, ConfigError) else 1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m chamfer_morph.worker", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    slot = commands.add_parser("run", help="work on jobs, one at a time")
    slot.add_argument("--slot", type=int, default=0, help="number of this slot on this machine")
    commands.add_parser("janitor", help="adopt jobs of dead workers, delete expired ones")
    adoption = commands.add_parser("adopt", help="queue the jobs of a dead worker again")
    adoption.add_argument("executor")
    alive = commands.add_parser(
        "alive", help="fail unless such a process on this machine is alive and responsive"
    )
    alive.add_argument("process", choices=["worker", "janitor"])
    alive.add_argument("--slot", type=int, default=0, help="number of the worker's slot")
    return parser


def _run(arguments: argparse.Namespace, settings: Settings) -> None:
    if arguments.command == "alive":
        name = executor_id(arguments.slot) if arguments.process == "worker" else janitor_id()
        if not liveness.gets_on(settings, name):
            sys.exit(f"The {arguments.process} is not running or not responding.")
        return
    from chamfer_morph.worker.dbos_adapter import check_reachable
    from chamfer_morph.worker.layout import check_layout
    from chamfer_morph.worker.storage import open_storage

    runs = arguments.command == "run"
    executor = executor_id(arguments.slot) if runs else "janitor"
    storage = open_storage(settings, executor)
    check_reachable(settings)
    check_layout(settings)
    if runs:
        telemetry.set_up("morph-worker")
        run_slot(settings, executor, storage)
    elif arguments.command == "janitor":
        from chamfer_morph.worker import janitor

        janitor.run(settings)
    else:
        adopt(settings, arguments.executor, storage)


def adopt(settings: Settings, executor: str, storage: Storage) -> None:
    """Queue the jobs again that a worker left, under its name; the caller holds its lock.

    It ends by a signal where it takes too long, whether or not the caller still lives.
    """
    signal.alarm(ADOPTION_LIMIT_SECONDS)
    from chamfer_morph.worker.engines.spare_engine import SpareEngine
    from chamfer_morph.worker.queue import JobQueue
    from chamfer_morph.worker.workflow import launch

    spare = SpareEngine(settings, storage)
    launch(settings, executor, spare, listen=False)  # DBOS queues them in a thread of its own
    queue = JobQueue(settings)
    while executor in queue.running():
        time.sleep(POLL_SECONDS)
    queue.wake_workers()
    os._exit(0)


def run_slot(settings: Settings, executor: str, storage: Storage) -> None:
    """Work until a signal or the loss of the slot's lock; jobs under way stay in the queue."""
    from chamfer_morph.worker.dbos_adapter import database
    from chamfer_morph.worker.engines.spare_engine import SpareEngine
    from chamfer_morph.worker.locks import wait_for_lock
    from chamfer_morph.worker.queue import JobQueue
    from chamfer_morph.worker.workflow import launch

    liveness.get_on(settings, executor)
    queue = JobQueue(settings)
    queue.migrate()
    queue.close()
    lock = wait_for_lock(settings, executor, LOCK_TIMEOUT_SECONDS)
    if lock is None:
        refuse(f"Another worker runs as {executor}.", "Stop it, or choose another --first-slot.")
    slots = WorkerSlots(database(settings, kept=1))
    slots.register(executor)
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    paused = slots.is_paused(executor)
    if paused:
        log.warning("%s is paused: it takes no jobs before `morph workers unpause`.", executor)
    spare = SpareEngine(settings, storage, partial(jobs_wait, queue))
    look_for_a_job = None if paused else launch(settings, executor, spare)
    last_check = time.monotonic()
    while not ended.is_set():
        if lock.wait_for_news(ended, NEWS_SECONDS) and look_for_a_job:
            look_for_a_job()
        if not paused:
            spare.keep()
        if time.monotonic() - last_check > LOCK_CHECK_SECONDS:
            last_check = time.monotonic()
            liveness.get_on(settings, executor)
            if not lock.held():
                spare.end()
                os._exit(1)  # somebody else may take its jobs: stop at once
            if paused and not slots.is_paused(executor):
                os._exit(ExitCode.PAUSED)  # start again, unpaused
    spare.end()
    with suppress(sa.exc.DBAPIError):  # the janitor does it, in a day
        slots.unregister(executor)
    telemetry.flush()
    os._exit(0)  # the engine process of its job ends with it


def refuse(cause: str, remedy: str, status: int = ExitCode.REFUSED) -> NoReturn:
    """End this process, and say why and what to do about it."""
    sys.stderr.write(f"{cause}\n{remedy}\n")
    sys.exit(status)


def jobs_wait(queue: JobQueue) -> bool:
    """Whether jobs are queued; asked seldom, so that no connection is kept for it."""
    try:
        return queue.waiting_since() is not None
    except sa.exc.DBAPIError:  # the slot's lock finds out what that means
        return False
    finally:
        queue.close()


if __name__ == "__main__":
    main()
