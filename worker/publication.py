"""Publishes what the engine of a job writes, while it writes, and waits for an object store."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial

from chamfer_morph.worker.storage import Storage, StoreUnavailableError

POLL_SECONDS = 0.3
LONGEST_PAUSE_SECONDS = 10.0

_LOG = logging.getLogger(__name__)


@asynccontextmanager
async def publishing(storage: Storage, job_id: str) -> AsyncIterator[asyncio.Task[None]]:
    """Publish what is new of a claimed job as it comes, until the body is left.

    Where the object store does not answer, the engine goes on meanwhile.

    Yields:
        A task that ends, with an `OwnershipLostError`, once the job belongs to another worker.
    """
    task = asyncio.create_task(_publish_always(storage, job_id))
    try:
        yield task
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError, Exception):
            await task


async def patiently(call: Callable[[], None], seconds: float) -> None:
    """Make a call in a thread, again and again where the object store does not answer.

    Args:
        call: What blocks, and may be repeated.
        seconds: For how long [s].

    Raises:
        StoreUnavailableError: It did not answer in time.
    """
    deadline, pause = time.monotonic() + seconds, POLL_SECONDS
    while True:
        try:
            await asyncio.to_thread(call)
            return
        except StoreUnavailableError:
            if time.monotonic() > deadline:
                raise
        await asyncio.sleep(pause)
        pause = min(2 * pause, LONGEST_PAUSE_SECONDS)


async def _publish_always(storage: Storage, job_id: str) -> None:
    publish = partial(storage.publish, job_id)
    while True:
        await asyncio.sleep(POLL_SECONDS)
        try:
            await patiently(publish, float("inf"))
        except OSError as error:  # the engine finds that, too
            _LOG.warning("job %s cannot be published at the moment: %s", job_id, error)
