"""The service from Python: `MorphClient` blocks, `AsyncMorphClient` awaits; both do the same."""

from __future__ import annotations

from chamfer_morph.client.connection import DEFAULT_TIMEOUT_SECONDS
from chamfer_morph.client.execution import AsyncExecution, BlockingExecution
from chamfer_morph.client.operations import Operations


class AsyncMorphClient(Operations, AsyncExecution):
    """The service, for use in an event loop.

        async with AsyncMorphClient() as client:
            job = await client.submit("sphere", "bunny.obj", frames=20)
            async for event in client.events(job.id):
                print(event.type, event.data)

    Args:
        server: Its address; MORPH_SERVER, or else this machine, if None.
        key: API key; MORPH_KEY, or else no key, if None.
        timeout_seconds: How long an answer may take [s].
    """

    async def close(self) -> None:
        """Close all connections."""
        await self._connection.close()

    async def __aenter__(self) -> AsyncMorphClient:
        return self

    async def __aexit__(self, *details: object) -> None:
        await self.close()


class MorphClient(Operations, BlockingExecution):
    """The service, blocking.

        with MorphClient() as client:
            job = client.submit("sphere", "bunny.obj", frames=20)
            if client.wait(job.id).state == "succeeded":
                client.download(job.id, "sphere-to-bunny.vtkhdf")

    Args:
        server: Its address; MORPH_SERVER, or else this machine, if None.
        key: API key; MORPH_KEY, or else no key, if None.
        timeout_seconds: How long an answer may take [s].
    """

    def __init__(
        self,
        server: str | None = None,
        *,
        key: str | None = None,
        timeout_seconds: float = DEFAULT_TIMEOUT_SECONDS,
    ) -> None:
        Operations.__init__(self, server, key=key, timeout_seconds=timeout_seconds)
        BlockingExecution.__init__(self)
        self._exit_stack.callback(self._portal.call, self._connection.close)

    def close(self) -> None:
        """Close all connections."""
        self._exit_stack.close()

    def __enter__(self) -> MorphClient:
        return self

    def __exit__(self, *details: object) -> None:
        self.close()
