"""The web page: one document for all its addresses, and the files that it loads."""

from __future__ import annotations

import mimetypes
import re
from pathlib import Path

from fastapi import APIRouter, Request
from starlette.responses import FileResponse

from server.problems import ProblemError

router = APIRouter(include_in_schema=False)

BUILT = Path(__file__).parent / "web" / "dist"
"""What `make page` builds from `server/web`."""

ENCODINGS = {"br": ".br", "gzip": ".gz"}
"""Content-Encoding to the suffix of a file compressed so, the smallest first."""

FOR_EVER = "public, max-age=31536000, immutable"
"""Names of assets hold a digest of what is in them."""

METHODS = ["GET", "HEAD"]


@router.api_route("/", methods=METHODS)
@router.api_route("/new", methods=METHODS)
@router.api_route("/compare", methods=METHODS)
@router.api_route("/jobs/{job_id}", methods=METHODS)
def get_page(request: Request) -> FileResponse:
    """The document, which finds out by its address what to show."""
    if not (BUILT / "index.html").is_file():
        raise ProblemError(
            404,
            "There is no web page here, because it has not been built.",
            "Run `make page` where Node.js is installed; the API works without it, see /docs.",
        )
    return _file(request, "index.html", "no-cache")


@router.api_route("/assets/{name}", methods=METHODS)
def get_asset(name: str, request: Request) -> FileResponse:
    """A script, a style sheet or a picture of the page."""
    if not re.fullmatch(r"[\w-][\w.-]*", name) or not (BUILT / "assets" / name).is_file():
        raise ProblemError(
            404, f"The page has no file {name[:80]!r}.", "Reload the page; it may be a new version."
        )
    return _file(request, f"assets/{name}", FOR_EVER)


def _file(request: Request, name: str, caching: str) -> FileResponse:
    """A file of the page, compressed if the browser takes it and the build made it so."""
    media_type = mimetypes.guess_type(name)[0] or "application/octet-stream"
    headers = {"Cache-Control": caching, "Vary": "Accept-Encoding"}
    for encoding in _accepted(request.headers.get("accept-encoding", "")):
        compressed = BUILT / f"{name}{ENCODINGS[encoding]}"
        if compressed.is_file():
            headers |= {"Content-Encoding": encoding}
            return FileResponse(compressed, headers=headers, media_type=media_type)
    return FileResponse(BUILT / name, headers=headers, media_type=media_type)


def _accepted(header: str) -> list[str]:
    """Those of our encodings that an Accept-Encoding header allows."""
    asked = {
        part.partition(";")[0].strip().lower()
        for part in header.split(",")
        if not re.search(r";\s*q=0(\.0*)?\s*$", part)
    }
    return [encoding for encoding in ENCODINGS if encoding in asked]
