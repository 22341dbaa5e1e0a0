"""The API process: answer requests on a socket until told to end."""

from __future__ import annotations

import gc
import socket

import uvicorn

from chamfer_morph.server.app import create_app
from chamfer_morph.server.context import ServerContext
from chamfer_morph.server.http.connection_limits import LimitedProtocol
from chamfer_morph.server.http.security_headers import SecurityHeaders
from chamfer_morph.worker.settings import Settings

GRACE_SECONDS = 5
KEEP_ALIVE_SECONDS = 30


class ApiServer(uvicorn.Server):
    """Ends event streams at once when it is told to stop, and waits a while for other requests."""

    def __init__(self, settings: Settings) -> None:
        self._app = create_app(settings)
        super().__init__(
            uvicorn.Config(
                SecurityHeaders(self._app),
                log_level="warning",
                access_log=False,
                server_header=False,
                lifespan="on",
                http=LimitedProtocol,
                ws="none",
                timeout_graceful_shutdown=GRACE_SECONDS,
                timeout_keep_alive=KEEP_ALIVE_SECONDS,
            )
        )

    @property
    def context(self) -> ServerContext:
        """What the endpoints share, once it has started."""
        context: ServerContext = self._app.state.context
        return context

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer.

        What lives until the end, imported modules above all, is taken out of garbage collection:
        to go through it halts all requests for a quarter of a second.
        """
        await super().startup(sockets)
        gc.collect()
        gc.freeze()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop answering."""
        self.context.event_hub.close()
        self.context.close_computations()
        await super().shutdown(sockets)
