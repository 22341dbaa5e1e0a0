"""A valid upload behind many bombs of another key: how long it takes.

A bomb is a mesh file that takes seconds to look through, and is refused.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import httpx
import numpy as np

from benchmarks.service.children import ChildrenWatch, children
from benchmarks.service.fairness import timed
from benchmarks.service.local_service import LocalService, processes, wait_until
from benchmarks.service.measurement import Measurement, counted, percentile

COUNT = 100
UPLOADS = 10
UNLIMITED = httpx.Limits(max_connections=None)
TETRAHEDRON = b"v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Send the bombs, and once the service is busy with them, some meshes one after the other."""
    ann, bob = (service.add_key(name, "submit") for name in ("ann", "bob"))
    content = bomb()
    with (
        service.served(0) as (api, supervisor),
        httpx.Client(base_url=api.base_url, timeout=None, limits=UNLIMITED) as other,
        ThreadPoolExecutor(count) as pool,
    ):
        (server,) = processes(supervisor, "chamfer_morph.server", "api")
        quiet = [timed(lambda n=n: upload(api, bob, n)) for n in range(UPLOADS)]
        with ChildrenWatch([server]) as watch:
            sent = [pool.submit(throw, other, content + b"#" * n, ann) for n in range(count)]
            wait_until(lambda: children(server), "Nobody looks through the bombs.")
            times = [timed(lambda n=n: upload(api, bob, UPLOADS + n)) for n in range(UPLOADS)]
            waiting = sum(not each.done() for each in sent)
        supervisor.terminate()
    note = f"slowest of {len(times)}, behind {count} bombs, {waiting} of which waited on"
    return [
        Measurement("valid upload", max(times), 10, "s", note),
        Measurement("the same, median", percentile(times, 50), None, "s"),
        Measurement("without bombs, median", percentile(quiet, 50), None, "s"),
        counted("children at a time", watch.most[0], service.settings.sandbox_processes),
    ]


def bomb() -> bytes:
    """Triangles without order."""
    chance = np.random.default_rng(1)
    centres = chance.uniform(0, 10, (20_000, 1, 3))
    points = (centres + chance.normal(0, 0.3, (20_000, 3, 3))).reshape(-1, 3)
    lines = [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in points]
    lines += [f"f {first} {first + 1} {first + 2}" for first in range(1, len(points), 3)]
    return "\n".join([*lines, "#"]).encode()


def upload(api: httpx.Client, key: dict[str, str], number: int) -> None:
    """Upload a mesh that no other equals."""
    content = TETRAHEDRON + b"#%d" % number
    answer = api.post("/v1/meshes", params={"name": "valid.obj"}, content=content, headers=key)
    assert answer.status_code == 201, answer.text


def throw(api: httpx.Client, content: bytes, key: dict[str, str]) -> None:
    """Upload a bomb; the trial may end before it is answered."""
    with suppress(httpx.TransportError):
        api.post("/v1/meshes", params={"name": "bomb.obj"}, content=content, headers=key)
