"""Hypothesis looks for the shortest history of jobs that breaks a rule, on every ground."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from benchmarks.histories.grounds import DatabaseGround, MemoryGround
from benchmarks.histories.history import ACTIONS, Violation, World
from tests.conftest import empty_database

BUDGET = settings(
    max_examples=60,
    stateful_step_count=25,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Adoptions, of which there are many, are not logged."""
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


@pytest.fixture
def memory(tmp_path: Path) -> World:
    """A queue in memory without jobs."""
    folder = tmp_path / "memory"
    folder.mkdir()
    return World(MemoryGround(folder))


@pytest.fixture
def sqlite(tmp_path: Path) -> Iterator[World]:
    """A queue on SQLite without jobs."""
    with closing(World(DatabaseGround(tmp_path / "sqlite"))) as world:
        yield world


def machine(*worlds: World) -> type[RuleBasedStateMachine]:
    """Does the same on each of these, and compares what is seen."""

    class Jobs(RuleBasedStateMachine):
        @initialize()
        def begin(self) -> None:
            for world in worlds:
                with world.on_clock():
                    world.begin(0)

        @rule(action=st.sampled_from(sorted(set(ACTIONS))), seed=st.integers(0, 2**16))
        def act(self, action: str, seed: int) -> None:
            self._everywhere(lambda world: world.step(action), seed)

        def teardown(self) -> None:
            try:
                self._everywhere(World.finish, 0)
            finally:
                for world in worlds:
                    with world.on_clock():
                        world.clear()

        def _everywhere(self, act, seed: int) -> None:
            for world in worlds:
                world.chance = Random(seed)
                with world.on_clock():
                    act(world)
            for world in worlds[1:]:
                assert world.seen == worlds[0].seen

    return Jobs


def test_memory_and_sqlite_keep_the_rules_and_see_the_same(memory: World, sqlite: World) -> None:
    """Whatever Hypothesis has owners, workers and the janitor do."""
    run_state_machine_as_test(machine(memory, sqlite), settings=BUDGET)


def test_postgres_keeps_the_rules(tmp_path: Path, postgres: str) -> None:
    """On the clock of the machine, which Postgres reads itself."""
    with empty_database(postgres) as url:
        ground = DatabaseGround(tmp_path / "data", url)
        with closing(World(ground, real_clock=True)) as world:
            run_state_machine_as_test(machine(world), settings=BUDGET)


def test_a_planted_bug_is_found_and_made_small(memory: World, monkeypatch) -> None:
    """Few steps are left of the history that shows it."""
    monkeypatch.setattr(type(memory.ground.storage), "discard_if_marked", lambda *_, **__: None)
    many = settings(BUDGET, max_examples=3000, phases=(Phase.generate, Phase.shrink))
    with pytest.raises(Violation, match="frames of before"):
        run_state_machine_as_test(machine(memory), settings=many)
    assert len(memory._done) <= 12
