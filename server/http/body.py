"""Request bodies as they come in, up to a size."""

from __future__ import annotations

from collections.abc import AsyncIterator

import anyio
from starlette.requests import Request

from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.settings import Settings


def media_type(request: Request) -> str:
    """Type of the body in lower case, without parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def chunks(request: Request, largest: int, settings: Settings) -> AsyncIterator[bytes]:
    """The body as it comes in.

    Raises:
        ProblemError: 413 too large, 408 stalled, 400 cut off.
    """
    declared = request.headers.get("content-length", "")
    if declared.isdigit() and int(declared) > largest:
        raise too_large(largest)
    stall, size = settings.upload_timeout_seconds, 0
    while True:
        try:
            with anyio.fail_after(stall):
                message = await request.receive()
        except TimeoutError:
            raise ProblemError(
                408,
                f"Nothing has come for {stall:g} s.",
                "Send it again, over a steadier connection.",
                headers={"Connection": "close"},
            ) from None
        if message["type"] == "http.disconnect":
            raise ProblemError(400, "The body was cut off.", "Send it again.") from None
        chunk: bytes = message.get("body", b"")
        size += len(chunk)
        if size > largest:
            raise too_large(largest)
        if chunk:
            yield chunk
        if not message.get("more_body", False):
            return


def too_large(largest: int) -> ProblemError:
    """The refusal of a body or file that is too large."""
    text = f"{largest / 2**20:.0f} MiB" if largest >= 1 << 20 else f"{largest} bytes"
    return ProblemError(
        413,
        f"This is larger than the {text} that are accepted.",
        "Send less; a mesh may be decimated, for the simulation sees no detail below half a grid "
        "unit.",
        headers={"Connection": "close", "Retry-After": "60"},
    )
