"""Download of a file: resumed where it broke off, checked, and whole or not there at all.

What has arrived lies beside it in `<name>.<SHA-256 of the whole file>.part`.
"""

from __future__ import annotations

import os
import re
from glob import escape
from pathlib import Path

import httpx

from chamfer_morph.client.connection import Connection
from chamfer_morph.client.errors import unexpected_answer
from chamfer_morph.client.retry import Attempts
from morph_engine.errors import ResultError
from morph_engine.files import file_sha256

_DIGEST = "[0-9a-f]" * 64
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
            f"{target} cannot be written to ({error.strerror or error}).",
            "Check that its folder exists, is writable and has free space. What has been "
            "downloaded is kept.",
        ) from error


async def _attempt(connection: Connection, path: str, target: Path, attempts: Attempts) -> bool:
    """Fetch what is missing of a file; True if it is whole then."""
    pattern = f"{escape(target.name)}.{_DIGEST}.part"
    part = min(target.parent.glob(pattern), default=None)
    headers = {"Accept-Encoding": "identity"}
    if part is not None and (size := part.stat().st_size):
        headers |= {"Range": f"bytes={size}-", "If-Range": f'"{_digest(part)}"'}
    try:
        async with connection.stream(path, headers=headers) as response:
            if response.is_success:
                digest = response.headers.get("etag", "").strip('"')
                if not re.fullmatch(_DIGEST, digest):
                    raise unexpected_answer(connection.server)
                if part is not None and response.status_code != 206:
                    part.unlink()
                part = target.with_name(f"{target.name}.{digest}.part")
                with part.open("ab") as file:
                    async for chunk in response.aiter_bytes():
                        file.write(chunk)
                        attempts.succeeded()
    except httpx.TransportError as error:
        await attempts.pause_after_loss(error)
        return False
    # a range beyond the end: it had all arrived; if not, the digest tells
    if part is not None and (response.is_success or response.status_code == _NO_SUCH_RANGE):
        _complete(part, target)
        return True
    await attempts.pause_after_refusal(response)
    return False


def _complete(part: Path, target: Path) -> None:
    """Make what has arrived the file, in one step.

    Raises:
        ResultError: Its digest is another one; it is gone then.
    """
    if file_sha256(part) != _digest(part):
        part.unlink()
        raise ResultError(
            f"{target.name} was damaged in transfer: its SHA-256 is not the expected one.",
            "Fetch it again.",
        )
    os.replace(part, target)


def _digest(part: Path) -> str:
    return part.name.split(".")[-2]
