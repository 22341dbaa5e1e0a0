"""Worker slots as the API and the figures show them, and when they are forgotten."""

from __future__ import annotations

import re

import pytest

from chamfer_morph.client import MorphClient
from chamfer_morph.server.routes import health
from chamfer_morph.worker import absent_slots
from chamfer_morph.worker.absent_slots import AbsentSlots
from chamfer_morph.worker.locks import try_lock
from tests.integration.api.conftest import Api
from tests.integration.api.test_api_broken_state import change
from tests.patience import until

SLOT = "elsewhere-slot0"


def _counts(api: Api) -> dict[str, int]:
    """Worker slots by state, without those that nobody is in."""
    found = re.findall(r'morph_workers{state="(\w+)"} (\d+)', api.http.get("/metrics").text)
    return {state: int(count) for state, count in found if int(count)}


def test_worker_slots_are_counted(either: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that nobody holds is dead as long as it has a job, and then it is none."""
    monkeypatch.setattr(health, "FIGURES_SECONDS", 0)
    slots = either.context.worker_slots
    slots.register(SLOT)
    assert _counts(either) == {}
    lock = try_lock(either.settings, SLOT)
    assert lock is not None
    try:
        assert _counts(either) == {"idle": 1}
        slots.pause(SLOT)
        assert _counts(either) == {"paused": 1}
        job = either.submit()["id"]
        change(either, job, status="PENDING", executor_id=SLOT)
        assert _counts(either) == {"busy": 1}
    finally:
        lock.release()
    until(lambda: _counts(either) == {"dead": 1})
    slots.unregister(SLOT)
    assert slots.all() == {SLOT: True}, "a paused one stays"
    slots.pause(SLOT, False)
    slots.unregister(SLOT)
    assert slots.all() == {}
    assert _counts(either) == {"dead": 1}, "its job tells of it"
    (shown,) = either.http.get("/v1/workers").json()
    assert shown == {"id": SLOT, "alive": False, "paused": False, "job": job}
    change(either, job, status="CANCELLED")
    assert either.http.get("/v1/workers").json() == []


def test_absent_slots_are_forgotten(either: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those without lock and job, in time; a paused one stays, to be paused when it comes again."""
    context = either.context
    absent = AbsentSlots(either.settings, context.engine, context.queue)
    for name in ("a-gone", "b-lives", "c-works", "d-paused"):
        context.worker_slots.register(name)
    context.worker_slots.pause("d-paused")
    change(either, either.submit()["id"], status="PENDING", executor_id="c-works")
    lock = try_lock(either.settings, "b-lives")
    assert lock is not None
    try:
        assert absent.forget() == []
        monkeypatch.setattr(absent_slots, "ABSENT_SECONDS", 0)
        assert absent.forget() == ["a-gone"]
        assert absent.forget() == []
    finally:
        lock.release()
    assert [*context.worker_slots.all()] == ["b-lives", "c-works", "d-paused"]


def test_workers_are_listed_in_pages(api: Api) -> None:
    """Each of them once, by name."""
    names = [f"host-slot{index}" for index in range(5)]
    for name in reversed(names):
        api.context.worker_slots.register(name)
    found: list[str] = []
    query = {"limit": 2, "after": ""}
    while page := api.http.get("/v1/workers", params=query).json():
        assert len(page) <= 2
        found += [worker["id"] for worker in page]
        query["after"] = found[-1]
    assert found == names
    with MorphClient(str(api.http.base_url)) as client:
        assert [worker.id for worker in client.workers()] == names
