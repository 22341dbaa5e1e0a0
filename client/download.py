"""Download of a result: resumed where it broke off, checked, and whole or not there at all."""

from __future__ import annotations

from pathlib import Path

import httpx

from chamfer_morph.client.connection import Call, Reply, Transport
from chamfer_morph.client.errors import strange_answer
from chamfer_morph.client.partial_file import PartialFile
from chamfer_morph.client.retry import Attempts
from morph_engine.errors import ResultError

_NO_SUCH_RANGE = 416


async def download(transport: Transport, path: str, target: Path) -> None:
    """Fetch what lies at `path` into a file.

    Raises:
        ServiceError: The service refuses or stays away; what has arrived is kept for next time.
        ResultError: What arrived is damaged, and is not kept; or the disk refuses.
    """
    try:
        await _download(transport, path, target)
    except OSError as error:
        raise ResultError(
            f"{target} cannot be written ({error.strerror or error}).",
            "See that its folder is there, has room and may be written to. What arrived is kept.",
        ) from error


async def _download(transport: Transport, path: str, target: Path) -> None:
    attempts = Attempts(transport.server)
    while True:
        part = PartialFile.find(target)
        try:
            async with transport.open(_call(path, part)) as reply:
                if reply.response.is_success:
                    part = _accepted(transport, reply, part, target)
                    with part.path.open("ab") as file:
                        async for chunk in reply.chunks:
                            file.write(chunk)
                            attempts.succeeded()
                    return part.keep()
                if reply.response.status_code == _NO_SUCH_RANGE and part is not None:
                    return part.keep()  # it had all arrived; if not, the digest tells
                pause = attempts.pause_after_refusal(reply.response)
        except httpx.TransportError as error:
            pause = attempts.pause_after_loss(error)
        await transport.sleep(pause)


def _call(path: str, part: PartialFile | None) -> Call:
    headers = {"Accept-Encoding": "identity"}
    if part is not None and part.size:
        headers |= {"Range": f"bytes={part.size}-", "If-Range": f'"{part.digest}"'}
    return Call("GET", path, headers=headers)


def _accepted(
    transport: Transport, reply: Reply, part: PartialFile | None, target: Path
) -> PartialFile:
    """Where the body of an answer goes: after what is there, or to a new beginning."""
    arriving = PartialFile.of_etag(target, reply.response.headers.get("etag", ""))
    if arriving is None:
        raise strange_answer(transport.server)
    if part is not None and reply.response.status_code != 206:
        part.discard()
    return arriving
