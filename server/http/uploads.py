"""Files that are sent, streamed to the disk.

FastAPI's `UploadFile` parameters do not serve here: they are received before the caller is known,
and never lie under a name that another process could open.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from collections.abc import AsyncGenerator, AsyncIterable, AsyncIterator, Callable
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import anyio
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request

from chamfer_morph.server.http.problems import ProblemError, too_large

Value = TypeVar("Value")

BLOCK_BYTES = 1 << 20
NAME_LENGTH = 200
MAX_PARTS = 16


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


@asynccontextmanager
async def save_upload(
    chunks: AsyncIterable[bytes],
    folder: Path,
    name: str,
    max_bytes: int,
    count: Callable[[int], None] | None,
) -> AsyncIterator[Upload]:
    """Write what comes in to a temporary file, gone in the end unless it was moved.

    Args:
        chunks: The content.
        folder: Where to put the file.
        name: What the user calls it.
        max_bytes: Its largest size.
        count: Told of the bytes that are written, unless they are counted already; may refuse more.

    Raises:
        ProblemError: 413, it is larger.
    """
    name = plain_name(name)
    suffix = Path(name).suffix.lower()
    path = folder / f"{secrets.token_hex(12)}{suffix if suffix[1:].isalnum() else ''}"
    digest, size = hashlib.sha256(), 0
    try:
        async with await anyio.open_file(path, "xb", buffering=BLOCK_BYTES) as file:
            async for chunk in chunks:
                size += len(chunk)
                if size > max_bytes:
                    raise too_large(max_bytes)
                if count is not None:
                    count(len(chunk))
                digest.update(chunk)
                await file.write(chunk)
        yield Upload(path, name, digest.hexdigest(), size)
    finally:
        path.unlink(missing_ok=True)


@asynccontextmanager
async def receive_form(
    request: Request, max_field_bytes: int, count: Callable[[int], None]
) -> AsyncIterator[FormData]:
    """The parts of a multipart form, each name once; its files are in temporary files.

    Args:
        request: The request.
        max_field_bytes: Largest part that is no file.
        count: Told of the bytes that come; may refuse more.

    Raises:
        ProblemError: 413 too large, 422 not a form, or a part that is there twice.
    """
    try:
        form = await _FormParser(request, max_field_bytes, count).parse()
    except MultiPartException as error:
        if "aximum" in error.message:  # Starlette tells what is too much in words only
            raise ProblemError(413, error.message, "Send fewer and smaller parts.") from None
        raise ProblemError(
            422,
            "The body is not a complete multipart form.",
            "Use an HTTP library to build it, or curl: `curl -F file=@bunny.obj`.",
        ) from None
    try:
        for name in form:
            if len(form.getlist(name)) > 1:
                raise ProblemError(
                    422, f"The form has two parts named {name!r}.", "Send each part only once."
                )
        yield form
    finally:
        await form.close()


class _FormParser(MultiPartParser):
    """Starlette's parser, which would take a form that was cut off for a whole one."""

    def __init__(
        self, request: Request, max_field_bytes: int, count: Callable[[int], None]
    ) -> None:
        super().__init__(
            request.headers,
            self._until_end(request.stream()),
            max_files=MAX_PARTS,
            max_fields=MAX_PARTS,
            max_part_size=max_field_bytes,
        )
        self._count = count
        self._ended = False

    def on_end(self) -> None:
        self._ended = True

    async def _until_end(self, chunks: AsyncIterable[bytes]) -> AsyncGenerator[bytes, None]:
        async for chunk in chunks:
            self._count(len(chunk))
            yield chunk
        if not self._ended:
            raise MultiPartException("The form is incomplete.")


async def enter_in_thread(stack: AsyncExitStack, manager: AbstractContextManager[Value]) -> Value:
    """Enter a context whose beginning and end block, until the end of the stack."""

    async def leave(*error: Any) -> bool | None:
        suppressed = None
        with anyio.CancelScope(shield=True):
            suppressed = await anyio.to_thread.run_sync(manager.__exit__, *error)
        return suppressed

    value = await anyio.to_thread.run_sync(manager.__enter__)
    stack.push_async_exit(leave)
    return value


async def read_blocks(file: UploadFile) -> AsyncIterator[bytes]:
    """The content of a part of a form, in pieces."""
    while block := await file.read(BLOCK_BYTES):
        yield block


def plain_name(name: str) -> str:
    """The last part of a file name as a user may send it, without control characters."""
    last = re.split(r"[/\\]", name)[-1]
    return "".join(letter for letter in last if letter.isprintable()).strip()[-NAME_LENGTH:]
