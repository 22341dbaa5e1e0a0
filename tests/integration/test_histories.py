"""Seeded histories of jobs keep their rules, and a bug planted in the queue breaks one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from benchmarks.histories import Violation, World
from chamfer_morph.worker import janitor, locks
from chamfer_morph.worker.locks import FileLock
from chamfer_morph.worker.storage import Storage

HISTORIES = 100
MORE = 300
"""Histories that may be played after those known to keep a rule in spite of a planted bug."""


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    """A queue without jobs."""
    with closing(World(tmp_path)) as world:
        yield world


def test_histories_keep_the_rules(world: World) -> None:
    """No job is lost, runs twice at once, or has its outcome overwritten; counts are sums."""
    for number in range(HISTORIES):
        world.play(number)


def test_fence_that_is_not_checked_is_found(world: World, monkeypatch) -> None:
    """Outcomes are written whoever owns the job."""
    write = world._dbos.update_workflow_outcome

    def unchecked(*arguments, owner_xid, **more):
        return write(*arguments, **more)

    monkeypatch.setattr(world._dbos, "update_workflow_outcome", unchecked)
    require_found(world, "lost its job", first=160)


def test_retry_that_forgets_to_clear_is_found(world: World, monkeypatch) -> None:
    """What a job has left stays where it is."""
    monkeypatch.setattr(Storage, "discard_if_marked", lambda *_, **__: None)
    require_found(world, "frames of before", first=240)


def test_lease_that_is_taken_twice_is_found(world: World, monkeypatch, tmp_path: Path) -> None:
    """The lock of a worker is given to whoever asks."""

    def always(settings, executor):
        return FileLock((tmp_path / "anybody").open("ab"))

    for module in (locks, janitor):
        monkeypatch.setattr(module, "try_lock", always)
    require_found(world, "second worker", first=0)


def require_found(world: World, rule: str, first: int) -> None:
    """One of the histories from the first on breaks this rule."""
    with pytest.raises(Violation, match=rule):
        for number in range(first, first + MORE):
            world.play(number)
