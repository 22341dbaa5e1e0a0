"""A real web server of public files for tests: ranges, versions, and everything that goes wrong."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit


class WebServer(ThreadingHTTPServer):
    """Serves `files` by path; as a proxy, those of any host.

    Attributes:
        files: Content by path without its slash.
        cuts: Bytes after which each of the next answers is cut off; None for a whole one.
        pauses: Bytes after which each of the next answers stops until its reader goes away.
        statuses: What the next requests are refused with.
        understands_ranges: Whether it sends parts and names versions.
        requests: Target and headers of each request.
    """

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.files: dict[str, bytes] = {}
        self.cuts: list[int | None] = []
        self.pauses: list[int] = []
        self.statuses: list[int] = []
        self.understands_ranges = True
        self.requests: list[tuple[str, dict[str, str]]] = []

    @property
    def url(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self.server_port}"

    def ranges(self) -> list[str]:
        """The range that each request asked for; empty for all."""
        return [headers.get("Range", "") for _, headers in self.requests]


class _Handler(BaseHTTPRequestHandler):
    server: WebServer

    def do_GET(self) -> None:
        server = self.server
        server.requests.append((self.path, dict(self.headers)))
        content = server.files.get(urlsplit(self.path).path.lstrip("/"))
        status = server.statuses.pop(0) if server.statuses else 200
        if content is None or status != 200:
            self.send_error(404 if content is None else status)
            return
        tag = f'"{hashlib.sha256(content).hexdigest()[:16]}"'
        start = 0
        asked = self.headers.get("Range", "")
        if server.understands_ranges and asked and self.headers.get("If-Range") == tag:
            start = int(asked.removeprefix("bytes=").removesuffix("-"))
            if start >= len(content):
                self.send_error(416)
                return
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        else:
            self.send_response(200)
        if server.understands_ranges:
            self.send_header("ETag", tag)
        self.send_header("Content-Length", str(len(content) - start))
        self.end_headers()
        if server.pauses:
            self.wfile.write(content[start : start + server.pauses.pop(0)])
            self.rfile.read(1)
            return
        cut = server.cuts.pop(0) if server.cuts else None
        self.wfile.write(content[start:] if cut is None else content[start : start + cut])

    def log_message(self, *arguments: object) -> None:
        """Say nothing."""


@contextmanager
def running() -> Iterator[WebServer]:
    """A server while the body runs."""
    with WebServer() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()
