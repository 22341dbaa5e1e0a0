"""Answers that hold a file which lies elsewhere, or the part of it that Range asks for."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Iterator
from urllib.parse import quote

import anyio
from fastapi import Request, Response
from starlette.concurrency import iterate_in_threadpool
from starlette.responses import StreamingResponse

from chamfer_morph.server.http.conditional import etag_headers, not_modified
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.worker.storage import RemoteFile

RANGE = re.compile(r"bytes=(\d{0,20})-(\d{0,20})")
"""No file has a size of more digits; what asks for a part beyond is answered with the whole."""


async def remote_file_response(
    request: Request, file: RemoteFile, etag: str, *, media_type: str, filename: str
) -> Response:
    """A file to save under a name, unless the caller has this version of it.

    A request for several ranges is answered with the whole file, as RFC 9110 allows.

    Raises:
        ProblemError: 416, the file has no such part.
        StoreUnavailableError: The object store does not answer.
    """
    headers = etag_headers(etag) | {
        "Accept-Ranges": "bytes",
        "Content-Disposition": f"attachment; filename*=utf-8''{quote(filename)}",
    }
    if answer := not_modified(request, headers):
        return answer
    begin, end = part_of(request, headers["ETag"], file.size)
    whole = (begin, end) == (0, file.size)
    headers["Content-Length"] = str(end - begin)
    if not whole:
        headers["Content-Range"] = f"bytes {begin}-{end - 1}/{file.size}"
    parts = file.read(begin, end)
    first = await anyio.to_thread.run_sync(next, parts, b"")  # while it can still be refused
    status = 200 if whole else 206
    return StreamingResponse(_chain(first, parts), status, headers, media_type)


def part_of(request: Request, etag: str, size: int) -> tuple[int, int]:
    """Where the part that a request asks for begins and ends; all of it without a Range.

    Raises:
        ProblemError: 416, there is no such part.
    """
    found = RANGE.fullmatch(request.headers.get("range", "").strip())
    if found is None or request.headers.get("if-range", etag) != etag or not any(found.groups()):
        return 0, size
    first, last = found.groups()
    if not first:
        begin, end = max(size - int(last), 0), size
    else:
        begin, end = int(first), min(int(last) + 1, size) if last else size
    if begin >= end:
        raise ProblemError(
            416,
            f"The file has {size} bytes, none of them in the requested range.",
            "Request a range within the length given by Content-Range.",
            headers={"Content-Range": f"bytes */{size}"},
        )
    return begin, end


async def _chain(first: bytes, parts: Iterator[bytes]) -> AsyncIterator[bytes]:
    yield first
    async for part in iterate_in_threadpool(parts):
        yield part
