"""Files that are sent, streamed to disk."""

from __future__ import annotations

import hashlib
import re
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import anyio
from starlette.requests import Request

from chamfer_morph.server.http.body import chunks, too_large
from chamfer_morph.worker.settings import Settings

WRITE_BYTES = 1 << 20
NAME_LENGTH = 200


@dataclass
class Upload:
    """A file that has come in.

    Attributes:
        path: Where it lies for the time of the request.
        name: What the user calls it.
        sha256: Digest of its content.
        size_bytes: Its size.
    """

    path: Path
    name: str
    sha256: str
    size_bytes: int


class TemporaryFile:
    """A temporary file being written, in pieces large enough to be worth a thread's while."""

    def __init__(self, path: Path, name: str, largest: int | None) -> None:
        self._path, self._name, self._largest = path, name, largest
        self._file = path.open("xb")
        self._digest = hashlib.sha256()
        self._buffer = bytearray()
        self._size = 0

    @classmethod
    @asynccontextmanager
    async def open(
        cls, folder: Path, name: str, largest: int | None = None
    ) -> AsyncIterator[TemporaryFile]:
        """Make one in a folder, gone in the end unless it was moved.

        Args:
            folder: Where.
            name: What the user calls it.
            largest: Its largest size [bytes]; None for any.
        """
        name = plain_name(name)
        suffix = Path(name).suffix.lower()
        path = folder / f"{secrets.token_hex(12)}{suffix if suffix[1:].isalnum() else ''}"
        file = cls(path, name, largest)
        try:
            yield file
        finally:
            file._file.close()
            path.unlink(missing_ok=True)

    async def write(self, data: bytes) -> None:
        """Append to it.

        Raises:
            ProblemError: 413 too large.
        """
        self._buffer += data
        self._size += len(data)
        if self._largest is not None and self._size > self._largest:
            raise too_large(self._largest)
        if len(self._buffer) >= WRITE_BYTES:
            await anyio.to_thread.run_sync(self._flush)

    async def close(self) -> Upload:
        """Finish writing."""
        await anyio.to_thread.run_sync(self._flush)
        self._file.close()
        return Upload(self._path, self._name, self._digest.hexdigest(), self._size)

    def _flush(self) -> None:
        data, self._buffer = self._buffer, bytearray()
        self._digest.update(data)
        self._file.write(data)


@asynccontextmanager
async def receive_file(
    request: Request, folder: Path, name: str, settings: Settings
) -> AsyncIterator[Upload]:
    """Stream the body to a temporary file, gone after the request unless it was moved.

    Raises:
        ProblemError: 413 too large, 408 stalled, 400 cut off.
    """
    async with TemporaryFile.open(folder, name) as file:
        async for chunk in chunks(request, settings.upload_bytes, settings):
            await file.write(chunk)
        yield await file.close()


def plain_name(name: str) -> str:
    """The last part of a file name as a user may send it, without control characters."""
    last = re.split(r"[/\\]", name)[-1]
    return "".join(letter for letter in last if letter.isprintable()).strip()[-NAME_LENGTH:]
