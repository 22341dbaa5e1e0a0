"""The service from Python: `MorphClient` blocks, `AsyncMorphClient` awaits; both do the same."""

from __future__ import annotations

from chamfer_morph.client.execution import AsyncExecution, BlockingExecution
from chamfer_morph.client.operations import Operations


class AsyncMorphClient(Operations, AsyncExecution):
    """The service, for use in an event loop.

    For example::

        async with AsyncMorphClient() as client:
            job = await client.submit("sphere", "bunny.obj", frames=20)
            async for event in client.events(job.id):
                print(event.type, event.data)

    Its arguments are those of `MorphClient`.
    """


class MorphClient(Operations, BlockingExecution):
    """The service, blocking.

    For example::

        with MorphClient() as client:
            job = client.submit("sphere", "bunny.obj", frames=20)
            if client.wait(job.id).state == "succeeded":
                client.download(job.id, "sphere-to-bunny.vtkhdf")

    Args:
        server: Its address; MORPH_SERVER, or else this machine, if None.
        key: API key; MORPH_KEY, or else no key, if None.
        timeout_seconds: How long an answer may take [s].
    """
