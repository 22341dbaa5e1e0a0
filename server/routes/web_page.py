"""The web page: one document for all its addresses, and the files that it loads."""

from __future__ import annotations

import json
import mimetypes
import re
from collections.abc import Awaitable, Callable, Iterable
from functools import lru_cache
from pathlib import Path

from fastapi import APIRouter, Request
from starlette.responses import Response

from chamfer_morph.server.http.problems import ProblemError, as_problem

router: APIRouter = APIRouter(include_in_schema=False)

BUILT = Path(__file__).parents[1] / "web" / "dist"
"""What `make page` builds from `server/web`."""

ENCODINGS = {"br": ".br", "gzip": ".gz"}
"""Content-Encoding to the suffix of a file compressed so, the smallest first."""

FOR_EVER = "public, max-age=31536000, immutable"
"""Names of assets hold a digest of what is in them."""

METHODS = ["GET", "HEAD"]


VIEWS: dict[str, tuple[str, ...]] = {
    "/": ("src/views/jobs/jobs.js",),
    "/new": ("src/views/new/new.js",),
    "/compare": ("src/views/compare/compare.js", "src/viewer/viewer.js"),
    "/gallery": ("src/views/gallery/gallery.js",),
    "/shared/{job_id}": ("src/views/job/job.js", "src/viewer/viewer.js"),
    "/jobs/{job_id}": ("src/views/job/job.js", "src/viewer/viewer.js"),
}
"""Modules that the page will ask for at an address, as the build's manifest calls them."""


def _document(address: str) -> Callable[[Request], Awaitable[Response]]:
    """The endpoint of an address of the page."""

    async def get_page(request: Request) -> Response:
        """The document, which finds out by its address what to show."""
        answer = _file(request, "index.html", "no-cache")
        if answer is None:
            raise ProblemError(
                404,
                "The web page has not been built.",
                "Run `make page`, which needs Node.js; the API works without the page, see /docs.",
            )
        if preloads := _preloads(BUILT, VIEWS[address]):
            answer.headers["Link"] = ", ".join(preloads)
        return answer

    return get_page


for _address in VIEWS:
    router.add_api_route(_address, _document(_address), methods=METHODS)


async def not_found(request: Request, error: Exception) -> Response:
    """An address that nothing is at: the page for a person, which says so, and a problem else."""
    asks_for_page = "text/html" in request.headers.get("accept", "") and request.method in METHODS
    if asks_for_page and not request.url.path.startswith(("/v1/", "/assets/")):
        answer = _file(request, "index.html", "no-cache")
        if answer is not None:
            answer.status_code = 404
            return answer
    return as_problem(error).response()


@router.api_route("/assets/{name}", methods=METHODS)
async def get_asset(name: str, request: Request) -> Response:
    """A script, a style sheet or a picture of the page."""
    known = re.fullmatch(r"[\w-][\w.-]*", name)
    answer = _file(request, f"assets/{name}", FOR_EVER) if known else None
    if answer is None:
        raise ProblemError(
            404,
            f"The page has no file {name[:80]!r}.",
            "Reload the page; it may have been updated.",
        )
    return answer


def _file(request: Request, name: str, caching: str) -> Response | None:
    """A file of the page, compressed if the browser takes it and the build made it so."""
    headers = {"Cache-Control": caching, "Vary": "Accept-Encoding"}
    for encoding in (*_accepted(request.headers.get("accept-encoding", "")), None):
        content = _content(BUILT / f"{name}{ENCODINGS.get(encoding or '', '')}")
        if content is not None:
            if encoding:
                headers["Content-Encoding"] = encoding
            media_type = mimetypes.guess_type(name)[0] or "application/octet-stream"
            return Response(content, headers=headers, media_type=media_type)
    return None


def _content(path: Path) -> bytes | None:
    """What is in a file; read again only when it has changed."""
    try:
        stat = path.stat()
    except (OSError, ValueError):
        return None
    return _read(path, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=256)
def _read(path: Path, mtime_ns: int, size: int) -> bytes:
    return path.read_bytes()


def _preloads(built: Path, modules: Iterable[str]) -> list[str]:
    """Entries of a Link header: what modules and those that they import are made of.

    They let a browser ask for all at once, before the first script has run.
    """
    text = _content(built / ".vite" / "manifest.json")
    if text is None:
        return []
    manifest = json.loads(text)
    chunks: dict[str, None] = {}
    waiting = [name for name in modules if name in manifest]
    while waiting:
        name = waiting.pop()
        if name not in chunks:
            chunks[name] = None
            waiting += manifest[name].get("imports", ())
    styles = dict.fromkeys(css for name in chunks for css in manifest[name].get("css", ()))
    return [
        *(f"</{manifest[name]['file']}>; rel=modulepreload" for name in chunks),
        *(f"</{css}>; rel=preload; as=style" for css in styles),
    ]


def _accepted(header: str) -> list[str]:
    """Those of our encodings that an Accept-Encoding header allows."""
    asked = {
        part.partition(";")[0].strip().lower()
        for part in header.split(",")
        if not re.search(r";\s*q=0(\.0*)?\s*$", part)
    }
    return [encoding for encoding in ENCODINGS if encoding in asked]
