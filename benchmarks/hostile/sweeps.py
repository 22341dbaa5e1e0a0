"""The largest sweep, 20 million jobs in 5 kB: how soon it is refused, and for how much memory."""

from __future__ import annotations

from benchmarks.service.fairness import timed
from benchmarks.service.local_service import (
    LocalService,
    forget_peak_memory,
    peak_memory,
    processes,
)
from benchmarks.service.measurement import Measurement, percentile

COUNT = 100
SWEEP = {
    "sources": [{"shape": "sphere"}] * 100,
    "targets": [{"shape": "star"}] * 100,
    "methods": ["flow"] * 20,
    "seeds": list(range(100)),
}


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Ask for it again and again; a short one that is refused comes before."""
    with service.served(0) as (api, supervisor):

        def refused(sweep: dict[str, object]) -> float:
            def ask() -> None:
                assert api.post("/v1/sweeps", json=sweep).status_code == 422

            return timed(ask)

        short = [refused(SWEEP | {"methods": []}) for _ in range(count)]
        (server,) = processes(supervisor, "chamfer_morph.server", "api")
        forget_peak_memory(server)
        before = peak_memory(server)
        long = [refused(SWEEP) for _ in range(count)]
        grown = peak_memory(server) - before
    note = f"{count} times, slowest {1000 * max(long):.0f} ms"
    return [
        Measurement("largest sweep, 99th percentile", 1000 * percentile(long, 99), 50, "ms", note),
        Measurement("largest sweep, median", 1000 * percentile(long, 50), None, "ms"),
        Measurement("short one, median", 1000 * percentile(short, 50), None, "ms"),
        Measurement("memory of the API, grown by", grown / 1e6, 5, "MB"),
    ]
