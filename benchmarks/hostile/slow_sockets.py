"""Thousands of connections that send half a request and wait; how soon `/livez` answers meanwhile.

Whoever is closed comes again at once. The service may open as many files as there are sockets and
more, so that it has to hold all of them until their time is over.
"""

from __future__ import annotations

import resource
import selectors
import socket
import time
from contextlib import suppress
from http.client import HTTPConnection
from multiprocessing import get_context
from multiprocessing.sharedctypes import Synchronized

import httpx

from benchmarks.service.fairness import timed
from benchmarks.service.local_service import LocalService, processes, wait_until
from benchmarks.service.measurement import Measurement, counted, percentile

COUNT = 5000
SPARE_FILES = 1000
HALF = b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX: "
SECONDS = 30.0
PAUSE_SECONDS = 0.05


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Hold the sockets, and ask `/livez` by new connections."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(most, count + SPARE_FILES), most))
    spawn = get_context("spawn")
    opened = spawn.Value("l", 0)
    with service.served(0) as (api, supervisor):
        quiet = answers(api.base_url, SECONDS / 3)
        others = spawn.Process(target=hold, args=(api.base_url.port, count, opened), daemon=True)
        others.start()
        wait_until(lambda: opened.value >= count, "The sockets do not open.")
        (server,) = processes(supervisor, "chamfer_morph.server", "api")
        held = server.num_fds()
        slow = answers(api.base_url, SECONDS)
        others.kill()
        others.join()
    note = f"{len(slow)} requests, median {percentile(slow, 50):.3f} s, {opened.value} sockets"
    return [
        Measurement("/livez, slowest", max(slow), 0.2, "s", note),
        Measurement("/livez, 99th percentile", percentile(slow, 99), None, "s"),
        Measurement("the same without sockets, slowest", max(quiet), None, "s"),
        Measurement("files of the API meanwhile", held, None, ""),
        counted("errors of /livez", slow.count(float("inf")), 0),
    ]


def hold(port: int, count: int, opened: Synchronized[int]) -> None:
    """Keep so many sockets open, each with half a request; `opened` counts all there ever were."""
    selector = selectors.DefaultSelector()

    def connect() -> None:
        with suppress(OSError):
            plain = socket.create_connection(("127.0.0.1", port), timeout=20)
            plain.sendall(HALF)
            selector.register(plain, selectors.EVENT_READ)
            opened.value += 1

    while True:
        while len(selector.get_map()) < count:
            connect()
        for key, _ in selector.select(timeout=1):  # an answer, or the end
            selector.unregister(key.fileobj)
            key.fileobj.close()


def answers(url: httpx.URL, seconds: float) -> list[float]:
    """How long each of some requests to `/livez` takes [s]; infinite where there is no answer."""
    times = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            times.append(timed(lambda: alive(url)))
        except OSError:
            times.append(float("inf"))
        time.sleep(PAUSE_SECONDS)
    return times


def alive(url: httpx.URL) -> None:
    """Ask `/livez` by a connection of its own."""
    connection = HTTPConnection(url.host, url.port, timeout=30)
    connection.request("GET", "/livez")
    answer = connection.getresponse()
    assert answer.status == 200, answer.status
    connection.close()
