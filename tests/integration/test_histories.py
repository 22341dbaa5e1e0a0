"""Seeded histories of jobs keep their rules, and a bug planted in the queue breaks one."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from benchmarks.histories.grounds import DatabaseGround, MemoryGround
from benchmarks.histories.history import Violation, World
from chamfer_morph.worker import event_log, janitor, locks
from chamfer_morph.worker.locks import FileLock
from chamfer_morph.worker.storage import Storage

IN_MEMORY = 100_000
ON_SQLITE = 100
MORE = 600
"""Histories that may be played after those known to keep a rule in spite of a planted bug."""


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    """A queue on SQLite without jobs."""
    with closing(World(DatabaseGround(tmp_path))) as world:
        yield world


@pytest.fixture
def memory(tmp_path: Path) -> World:
    """A queue in memory without jobs."""
    folder = tmp_path / "memory"
    folder.mkdir()
    return World(MemoryGround(folder))


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Adoptions, of which there are many, are not logged."""
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


def test_histories_keep_the_rules(memory: World) -> None:
    """No job is lost, runs twice at once, waits out of turn, or has its outcome overwritten.

    After a crash at most the frame that was under way is computed again, and events tell of each
    frame once, in their order.
    """
    for number in range(IN_MEMORY):
        memory.play(number)


def test_sqlite_and_memory_see_the_same(world: World, memory: World) -> None:
    """After each step of the same histories, on both of which the rules are kept."""
    for number in range(ON_SQLITE):
        assert world.play(number) == memory.play(number), number


def test_fence_that_is_not_checked_is_found(world: World, monkeypatch) -> None:
    """Outcomes are written whoever owns the job."""
    write = world.ground.dbos.update_workflow_outcome

    def unchecked(*arguments, owner_xid, **more):
        return write(*arguments, **more)

    monkeypatch.setattr(world.ground.dbos, "update_workflow_outcome", unchecked)
    require_found(world, "lost its job")


def test_retry_that_forgets_to_clear_is_found(world: World, monkeypatch) -> None:
    """What a job has left stays where it is."""
    monkeypatch.setattr(Storage, "discard_if_marked", lambda *_, **__: None)
    require_found(world, "frames of before")


def test_lease_that_is_taken_twice_is_found(world: World, monkeypatch, tmp_path: Path) -> None:
    """The lock of a worker is given to whoever asks."""

    def always(settings, executor):
        return FileLock((tmp_path / "anybody").open("ab"))

    for module in (locks, janitor):
        monkeypatch.setattr(module, "try_lock", always)
    require_found(world, "second worker")


def test_resume_that_begins_anew_is_found(world: World, monkeypatch) -> None:
    """Whatever a job has computed is cleared whenever a worker takes it up."""

    def clear(storage, job, *, wait_seconds):
        storage.remove_job(job)

    monkeypatch.setattr(Storage, "discard_if_marked", clear)
    require_found(world, "more is computed again")


def test_frames_that_are_told_twice_are_found(world: World, monkeypatch) -> None:
    """An engine that goes on forgets what others were told before."""
    monkeypatch.setattr(event_log, "told_frames", lambda events: set())
    require_found(world, "events do not tell")


def require_found(world: World, rule: str) -> None:
    """One of the first histories breaks this rule."""
    with pytest.raises(Violation, match=rule):
        for number in range(MORE):
            world.play(number)
