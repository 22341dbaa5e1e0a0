"""Answers that hold a file, or tell the caller that it has that version already."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from fastapi import Request, Response

CACHE_CONTROL = "private, no-cache"
"""A browser keeps the answer, and asks each time whether it still holds."""


def etag_headers(etag: str) -> dict[str, str]:
    """Headers of an answer of which this is the version."""
    return {"ETag": f'"{etag}"', "Cache-Control": CACHE_CONTROL}


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """That the caller has the version with these headers already, if so."""
    wanted = request.headers.get("if-none-match", "")
    tags = {tag.strip().removeprefix("W/") for tag in wanted.split(",")}
    known = headers["ETag"] in tags or "*" in tags
    return Response(status_code=304, headers=dict(headers)) if known else None


def bytes_response(
    request: Request, body: bytes, media_type: str, headers: Mapping[str, str] | None = None
) -> Response:
    """Bytes, of which the digest is the version, unless the caller has them."""
    all_headers = etag_headers(hashlib.sha256(body).hexdigest()) | dict(headers or {})
    return not_modified(request, all_headers) or Response(
        body, headers=all_headers, media_type=media_type
    )
