"""Many idle workers on one Postgres database: their transactions and their connections.

Needs `--database`, and `--pooler` for more workers than Postgres has connections for: it has to let
in three for each without one. Those of the API and the janitor are counted as the workers'.
"""

from __future__ import annotations

import sys
import time

import httpx

from benchmarks.service.local_service import LocalService, wait_until
from benchmarks.service.measurement import Measurement, counted
from benchmarks.service.postgres_load import connections_to, transactions_of

COUNT = 50
SETTLE_SECONDS = 30.0
SECONDS = 120.0
LOOK_SECONDS = 5.0


def measure(service: LocalService, count: int) -> list[Measurement]:
    """Start the workers, let them rest, and count."""
    if not service.database_url:
        sys.exit("idle needs --database.")
    with service.served(count, warm_engines=False) as (api, _):
        wait_until(lambda: alive(api) == count, f"Not all of {count} workers start.")
        time.sleep(SETTLE_SECONDS)
        before, began = transactions_of(service.database_url), time.monotonic()
        connections = []
        while time.monotonic() - began < SECONDS:
            connections.append(connections_to(service.database_url))
            time.sleep(LOOK_SECONDS)
        made = transactions_of(service.database_url) - before
        rate = made / (time.monotonic() - began)
    way = "through a pooler" if service.pooler_url else "each by itself"
    note = f"{count} workers, connected {way}; {rate:.0f} transactions a second in all"
    return [
        Measurement("transactions of a worker", rate / count, 5, "1/s", note),
        counted("connections to Postgres", max(connections), 100),
    ]


def alive(api: httpx.Client) -> int:
    """Worker slots that are there."""
    time.sleep(1)  # each is asked for its lock, by a connection
    return sum(worker["alive"] for worker in api.get("/v1/workers").json())
