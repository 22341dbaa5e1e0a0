"""A real S3 server, and a link to it that can be cut."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx

BUCKET = "morph"

SERVER_ERROR = (
    b"HTTP/1.1 500 Internal Server Error\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
)


@contextmanager
def s3_server(log: Path) -> Iterator[tuple[str, int]]:
    """Address of an S3 server of our own, with a bucket."""
    with log.open("wb") as output:
        server = subprocess.Popen(
            [sys.executable, "-u", "-m", "moto.server", "-H", "127.0.0.1", "-p", "0"],
            stdout=output, stderr=subprocess.STDOUT,
            env=os.environ | {"S3_UPLOAD_PART_MIN_SIZE": "1"},  # which S3 has from 5 MiB on
        )  # fmt: skip
    try:
        while not (found := re.search(r"http://127\.0\.0\.1:(\d+)", log.read_text())):
            assert server.poll() is None, log.read_text()
        address = "127.0.0.1", int(found[1])
        httpx.put(f"http://{address[0]}:{address[1]}/{BUCKET}", timeout=60).raise_for_status()
        yield address
    finally:
        server.kill()
        server.wait()


class Link:
    """A link of TCP connections to an address, which can be cut, silenced and mended.

    Args:
        target: Host and port.

    Attributes:
        port: Of 127.0.0.1, where it begins.
        refused: Requests that got the status 500.
        delay: What goes either way is held up so long, each piece of it [s].
        rate: What it carries, either way [bytes/s].
        cut_at: The link is cut in place of letting these bytes through, if any, the first time.
        was_cut: Set once it was.
        silent_at: It is silenced in place of letting these bytes through, if any, the first time.
    """

    def __init__(self, target: tuple[str, int]) -> None:
        self._target = target
        self._whole = threading.Event()
        self._whole.set()
        self._passing = {back: threading.Event() for back in (False, True)}
        self._failing = False
        self.refused = 0
        self.delay = 0.0
        self.rate = float("inf")
        for passing in self._passing.values():
            passing.set()
        self.cut_at = b""
        self.was_cut = threading.Event()
        self.silent_at = b""
        self._sockets: set[socket.socket] = set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def fail(self) -> None:
        """Break every connection; whoever comes anew gets the status 500 for each request."""
        self._failing = True
        self._break()

    def cut(self) -> None:
        """Break every connection; new ones are accepted and get no answer."""
        self._whole.clear()
        self._break()

    def silence(self, *, there: bool = True, back: bool = True) -> None:
        """Let nothing through, one way or both, and break no connection; what is sent meanwhile
        arrives once the link is mended.
        """  # noqa: D205
        for way, silenced in ((False, there), (True, back)):
            if silenced:
                self._passing[way].clear()

    def _break(self) -> None:
        for end in [*self._sockets]:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        """Let connections through again, at once."""
        self._failing = False
        self.delay = 0.0
        self._whole.set()
        for passing in self._passing.values():
            passing.set()

    def close(self) -> None:
        """Accept no more connections."""
        self._listener.close()
        self.cut()
        for passing in self._passing.values():
            passing.set()

    def _accept(self) -> None:
        with suppress(OSError):  # closed
            while True:
                near, _ = self._listener.accept()
                threading.Thread(target=self._join, args=(near,), daemon=True).start()

    def _join(self, near: socket.socket) -> None:
        self._whole.wait()
        if self._failing:
            self._refuse(near)
            return
        far = socket.create_connection(self._target)
        self._sockets |= {near, far}
        back = threading.Thread(
            target=self._copy, args=(far, near), kwargs={"back": True}, daemon=True
        )
        back.start()
        self._copy(near, far, back=False)
        back.join()
        self._sockets -= {near, far}
        near.close()
        far.close()

    def _refuse(self, near: socket.socket) -> None:
        """Take a request, whole, and answer it with an error."""
        with near, suppress(OSError), near.makefile("rb") as request:
            length = 0
            while (line := request.readline()) not in (b"\r\n", b""):
                name, _, value = line.partition(b":")
                if name.lower() == b"content-length":
                    length = int(value)
            request.read(length)
            near.sendall(SERVER_ERROR)
            self.refused += 1

    def _copy(self, source: socket.socket, sink: socket.socket, *, back: bool) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                time.sleep(self.delay)
                if not back and self.cut_at and self.cut_at in data:
                    self.cut_at = b""
                    self.cut()
                    self.was_cut.set()
                    break
                if not back and self.silent_at and self.silent_at in data:
                    self.silent_at = b""
                    self.silence()
                time.sleep(len(data) / self.rate)
                self._passing[back].wait()
                sink.sendall(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
