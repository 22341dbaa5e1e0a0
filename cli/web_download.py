"""Download of a public file over HTTP: resumed where it broke off, and whole or not there at all.

What has arrived lies beside the file in `<name>.part`, and in `<name>.part.version` how the server
names the version of the file that it is a part of.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import httpx

from morph_engine.errors import MeshError

SIZE_LIMIT = 256 * 2**20
"""Most bytes of a file."""

ATTEMPTS = 5
"""In a row that bring nothing new."""

TIMEOUT_SECONDS = 30.0
FIRST_PAUSE_SECONDS = 0.2

_PASSING = {408, 425, 429, 500, 502, 503, 504}


class _Passing(Exception):
    """A failure that may pass."""


@contextmanager
def web_client() -> Iterator[httpx.Client]:
    """A client that heeds HTTP_PROXY, HTTPS_PROXY, ALL_PROXY and NO_PROXY.

    Raises:
        MeshError: These name a proxy of a kind that is not known.
    """
    try:
        client = httpx.Client(
            follow_redirects=True,
            timeout=TIMEOUT_SECONDS,
            headers={
                "User-Agent": f"chamfer-morph/{version('chamfer-morph')}",
                "Accept-Encoding": "identity",
            },
        )
    except (ImportError, ValueError, httpx.InvalidURL) as error:
        raise MeshError(
            f"The proxy of the environment cannot be used ({_line(error)}).",
            "Set HTTPS_PROXY, HTTP_PROXY and ALL_PROXY to http://HOST:PORT, or unset them.",
        ) from error
    with client:
        yield client


def download(client: httpx.Client, url: str, target: Path) -> Path:
    """Fetch a file into `<target>.part`, or the rest of it; the caller checks and renames that.

    Returns:
        The part, which is whole now.

    Raises:
        MeshError: There is no such file, no connection, or the file is too large. What has arrived
            of a file that broke off is kept.
        OSError: The disk refuses.
    """
    part = target.with_name(f"{target.name}.part")
    furthest, failures = _size(part), 0
    while True:
        try:
            return _receive(client, url, part)
        except (httpx.TransportError, _Passing) as error:
            failures = 1 if _size(part) > furthest else failures + 1
            furthest = max(furthest, _size(part))
            if failures >= ATTEMPTS:
                raise _broken_off(url, part, error) from error
            time.sleep(FIRST_PAUSE_SECONDS * 2 ** (failures - 1))
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise MeshError(
                f"{url} cannot be fetched ({_line(error)}).", "Use another source with --from."
            ) from error


def discard(part: Path) -> None:
    """Remove a part and its version."""
    part.unlink(missing_ok=True)
    _version_file(part).unlink(missing_ok=True)


def complete(part: Path, target: Path) -> None:
    """Make a part the file, in one step."""
    part.replace(target)
    _version_file(part).unlink(missing_ok=True)


def _receive(client: httpx.Client, url: str, part: Path) -> Path:
    """One request for what is missing."""
    arrived = _size(part)
    headers = {}
    if arrived and (known := _version(part)):
        headers = {"Range": f"bytes={arrived}-", "If-Range": known}
    with client.stream("GET", url, headers=headers) as response:
        status = response.status_code
        if status == 416:  # it is shorter than what has arrived
            discard(part)
        if status in _PASSING or status == 416:
            raise _Passing(f"HTTP status {status}")
        if not response.is_success:
            raise MeshError(
                f"{url} is not available: the server answered {status} {response.reason_phrase}.",
                "Use --from to name another URL or a folder that has "
                f"{part.name.removesuffix('.part')}.",
            )
        resumed = status == 206
        if resumed and not response.headers.get("Content-Range", "").startswith(
            f"bytes {arrived}-"
        ):
            discard(part)
            raise _Passing("the server did not send the requested range")
        if not resumed:
            discard(part)
            arrived = 0
            _keep_version(part, response)
        _append(response, part, arrived, url)
    return part


def _append(response: httpx.Response, part: Path, arrived: int, url: str) -> None:
    with part.open("ab") as file:
        for block in response.iter_raw():
            arrived += len(block)
            if arrived > SIZE_LIMIT:
                break
            file.write(block)
    if arrived > SIZE_LIMIT:
        discard(part)
        raise MeshError(
            f"{url} has more than {SIZE_LIMIT >> 20} MiB, so it is not the expected file.",
            "Use another source with --from.",
        )


def _keep_version(part: Path, response: httpx.Response) -> None:
    """Write down what If-Range needs: a strong entity tag, or else the date."""
    tag = response.headers.get("ETag", "")
    known = tag if tag.startswith('"') else response.headers.get("Last-Modified", "")
    _version_file(part).write_text(known, encoding="latin-1")


def _version(part: Path) -> str:
    try:
        return _version_file(part).read_text(encoding="latin-1")
    except FileNotFoundError:
        return ""


def _version_file(part: Path) -> Path:
    return part.with_name(f"{part.name}.version")


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _broken_off(url: str, part: Path, error: Exception) -> MeshError:
    if size := _size(part):
        return MeshError(
            f"The download of {url} stopped after {size} bytes ({_line(error)}).",
            "What has been downloaded is kept; repeat the command to fetch the rest.",
        )
    return MeshError(
        f"{url} cannot be reached ({_line(error)}).",
        "Check the network and HTTPS_PROXY, or use --from to name a folder or another URL "
        f"that has {part.name.removesuffix('.part')}.",
    )


def _line(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
