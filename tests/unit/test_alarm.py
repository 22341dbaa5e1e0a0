"""A worker looks for a job when it is told, when its own has ended, and from time to time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from chamfer_morph.worker import alarm
from chamfer_morph.worker.alarm import Alarm

FOR_EVER = 3600.0


@pytest.fixture(autouse=True)
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """As it is after the first seconds."""
    monkeypatch.setattr(alarm, "SETTLING_SECONDS", 0.0)


def waiting(alarm: Alarm) -> Callable[[], bool]:
    """Waits in a thread; the answer is what has come of it."""
    results: list[bool] = []
    thread = threading.Thread(target=lambda: results.append(alarm.wait(FOR_EVER)))
    thread.start()

    def end() -> bool:
        thread.join()
        return results[0]

    return end


def test_it_rings() -> None:
    """Also where it has rung before somebody waits, and once for each time."""
    alarm = Alarm(lambda: False)
    end = waiting(alarm)
    alarm.ring()
    assert not end()
    alarm.ring()
    assert not alarm.wait(FOR_EVER)
    assert not alarm.wait(0.01)


def test_the_end_of_a_job_rings() -> None:
    """Even if the job was not there yet when the wait began."""
    jobs: list[str] = []
    looks = []

    def is_busy() -> bool:
        looks.append(len(jobs))
        return bool(jobs)

    end = waiting(Alarm(is_busy))
    while not looks:
        time.sleep(0.01)
    jobs.append("a")
    while 1 not in looks:
        time.sleep(0.01)
    jobs.clear()
    assert not end()


def test_it_can_be_stopped() -> None:
    """Which is what the event in its place is for."""
    alarm = Alarm(lambda: False)
    end = waiting(alarm)
    alarm.set()
    assert end() and alarm.wait(FOR_EVER)


def test_it_looks_often_at_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs that the slot has left behind are just being queued again."""
    monkeypatch.setattr(alarm, "SETTLING_SECONDS", FOR_EVER)
    assert not Alarm(lambda: False).wait(FOR_EVER)
