"""Answers that hold a file, or tell the caller that it has that version already."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fastapi import Request, Response
from starlette.responses import FileResponse

CACHE_CONTROL = "private, no-cache"
"""A browser keeps the answer, and asks each time whether it still holds."""

BINARY: dict[str, Any] = {"schema": {"type": "string", "format": "binary"}}


def binary_responses(
    description: str,
    media_types: Iterable[str],
    headers: Mapping[str, tuple[str, str]] | None = None,
    *,
    ranges: bool = False,
) -> dict[int | str, dict[str, Any]]:
    """The contract of an endpoint that answers a file.

    Args:
        description: What the file holds.
        media_types: Its media types.
        headers: Further headers by name: the JSON type of each and its meaning.
        ranges: Whether it understands Range.
    """
    content = dict.fromkeys(media_types, BINARY)
    success: dict[str, Any] = {"content": content, "description": description}
    if headers:
        success["headers"] = {
            name: {"schema": {"type": kind}, "description": meaning}
            for name, (kind, meaning) in headers.items()
        }
    responses: dict[int | str, dict[str, Any]] = {
        200: success,
        304: {"description": "Not modified."},
    }
    if ranges:
        responses[206] = {"content": content, "description": "The requested range."}
    return responses


def etag_headers(etag: str) -> dict[str, str]:
    """Headers of an answer of which this is the version."""
    return {"ETag": f'"{etag}"', "Cache-Control": CACHE_CONTROL}


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """That the caller has the version with these headers already, if so."""
    known = request.headers.get("if-none-match", "")
    tags = {tag.strip().removeprefix("W/") for tag in known.split(",")}
    matches = headers["ETag"] in tags or "*" in tags
    return Response(status_code=304, headers=dict(headers)) if matches else None


def bytes_response(
    request: Request, body: bytes, media_type: str, headers: Mapping[str, str] | None = None
) -> Response:
    """Bytes, of which the digest is the version, unless the caller has them."""
    headers = etag_headers(hashlib.sha256(body).hexdigest()) | dict(headers or {})
    return not_modified(request, headers) or Response(body, headers=headers, media_type=media_type)


def file_response(
    request: Request,
    path: Path,
    etag: str,
    *,
    media_type: str,
    filename: str,
    cache_control: str = CACHE_CONTROL,
) -> Response:
    """A file to save under a name, unless the caller has this version of it."""
    headers = etag_headers(etag) | {"Cache-Control": cache_control}
    return not_modified(request, headers) or FileResponse(
        path, headers=headers, media_type=media_type, filename=filename
    )
