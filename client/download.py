"""Download of a file: resumed where it broke off, checked, and whole or not there at all."""

from __future__ import annotations

from pathlib import Path

import httpx

from chamfer_morph.client.connection import Connection
from chamfer_morph.client.errors import unexpected_answer
from chamfer_morph.client.partial_file import PartialFile
from chamfer_morph.client.retry import Attempts
from morph_engine.errors import ResultError

_NO_SUCH_RANGE = 416


async def download(connection: Connection, path: str, target: Path) -> None:
    """Fetch what lies at `path` into a file.

    Raises:
        ServiceError: The service refuses or stays away; what has arrived is kept for next time.
        ResultError: What arrived is damaged, and is not kept; or the disk refuses.
    """
    attempts = Attempts(connection.server)
    try:
        while not await _attempt(connection, path, target, attempts):
            pass
    except OSError as error:
        raise ResultError(
            f"{target} cannot be written ({error.strerror or error}).",
            "See that its folder is there, has room and may be written to. What arrived is kept.",
        ) from error


async def _attempt(connection: Connection, path: str, target: Path, attempts: Attempts) -> bool:
    """Fetch what is missing of a file; True if it is whole then."""
    part = PartialFile.find(target)
    headers = {"Accept-Encoding": "identity"}
    if part is not None and part.size:
        headers |= {"Range": f"bytes={part.size}-", "If-Range": f'"{part.digest}"'}
    try:
        async with connection.stream(path, headers=headers) as response:
            if response.is_success:
                await _receive(connection, response, part, target, attempts)
                return True
    except httpx.TransportError as error:
        await attempts.pause_after_loss(error)
        return False
    if response.status_code == _NO_SUCH_RANGE and part is not None:
        part.complete()  # it had all arrived; if not, the digest tells
        return True
    await attempts.pause_after_refusal(response)
    return False


async def _receive(
    connection: Connection,
    response: httpx.Response,
    part: PartialFile | None,
    target: Path,
    attempts: Attempts,
) -> None:
    """Write the body of an answer after what is there, or to a new beginning."""
    arriving = PartialFile.from_etag(target, response.headers.get("etag", ""))
    if arriving is None:
        raise unexpected_answer(connection.server)
    if part is not None and response.status_code != 206:
        part.discard()
    with arriving.path.open("ab") as file:
        async for chunk in response.aiter_bytes():
            file.write(chunk)
            attempts.succeeded()
    arriving.complete()
