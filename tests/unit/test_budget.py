"""What children may take together: over processes, with room for others, and free after a kill."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path

import pytest

from chamfer_morph.server.turns import Turns
from chamfer_morph.worker.sandbox.budget import Budget, Demand, Ticket

GIB = 1 << 30

HOLDER = """
import sys
from pathlib import Path
from chamfer_morph.worker.sandbox.budget import Budget, Demand
budget = Budget(Path(sys.argv[1]), processes=2, memory_bytes=4 << 30, reserve_bytes=1 << 30)
ticket = budget.enter(Demand("ann", 3 << 30, False))
assert budget.begin([ticket]) == [ticket]
print("begun", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where the demands lie."""
    return tmp_path / "children"


def budget(folder: Path, processes: int = 4, memory: int = 8, reserve: int = 2) -> Budget:
    """A budget, as each process makes its own; memory in GiB."""
    return Budget(
        folder, processes=processes, memory_bytes=memory * GIB, reserve_bytes=reserve * GIB
    )


Enter = Callable[..., list[Ticket]]


@pytest.fixture
def enter() -> Iterator[Enter]:
    """Enters children that somebody wants, until the end of the test; memory in GiB."""
    entered: list[Ticket] = []

    def enter(
        budget: Budget, owner: str, count: int = 1, *, gib: int = 1, long: bool = False
    ) -> list[Ticket]:
        tickets = [budget.enter(Demand(owner, gib * GIB, long)) for _ in range(count)]
        entered.extend(tickets)
        return tickets

    yield enter
    for ticket in entered:
        ticket.close()


def test_processes_are_counted_over_all_budgets(folder: Path, enter: Enter) -> None:
    """A key leaves one to others; what ends makes room, in whichever process."""
    one, other = budget(folder), budget(folder)
    ann = enter(one, "ann", 5)
    assert one.begin(ann) == ann[:3]
    bob = enter(other, "bob", 2)
    assert other.begin(bob) == bob[:1]
    assert one.begin(ann[3:]) == [] == other.begin(bob[1:])
    ann[0].close()
    assert one.begin(ann[3:]) == []  # bob has fewer
    assert other.begin(bob[1:]) == bob[1:]
    for ticket in (*ann[:3], *bob):
        ticket.close()
    assert one.begin(ann[3:]) == ann[3:]


def test_memory_is_counted(folder: Path, enter: Enter) -> None:
    """A key leaves the reserve to others, and long children leave it to short ones."""
    one = budget(folder, processes=9)
    long = [*chain(*(enter(one, name, gib=3, long=True) for name in ("ann", "bob", "cid")))]
    assert one.begin(long) == long[:2]
    assert one.begin(enter(one, "ann", gib=4)) == []  # ann would leave one GiB to all others
    (bob,) = enter(one, "dan", gib=2)
    assert one.begin([long[2], bob]) == [bob]
    long[0].close()
    assert one.begin([long[2]]) == []
    bob.close()
    assert one.begin([long[2]]) == [long[2]]


def test_a_single_child_fits(folder: Path, enter: Enter) -> None:
    """However little there is."""
    small = budget(folder, processes=1, memory=2, reserve=2)
    assert small.largest_bytes == GIB
    (ticket,) = enter(small, "ann")
    assert small.begin([ticket]) == [ticket]


def test_a_killed_process_holds_nothing(folder: Path, enter: Enter) -> None:
    """What it had is free as soon as it is gone."""
    command = [sys.executable, "-c", HOLDER, folder]
    one = budget(folder, processes=2, memory=4, reserve=1)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == b"begun\n"
        (ticket,) = enter(one, "bob", gib=2)
        assert one.begin([ticket]) == []
        holder.kill()
        holder.wait()
    assert one.begin([ticket]) == [ticket]
    ticket.close()
    assert [*folder.iterdir()] == []


def test_turns_rotate(folder: Path) -> None:
    """Of each kind a key has few at a time, and who has asked for much waits behind the others."""
    begun: list[str] = []

    async def main() -> None:
        turns = Turns(budget(folder, processes=2))
        kind = turns.kind(GIB)
        end = asyncio.Event()

        async def one(owner: str) -> None:
            async with kind(owner):
                begun.append(owner)
                await end.wait()

        tasks = [asyncio.create_task(one("ann")) for _ in range(20)]
        while begun != ["ann"]:
            await asyncio.sleep(0.01)
        tasks.append(asyncio.create_task(one("bob")))
        while len(begun) < 2:
            await asyncio.sleep(0.01)
        assert begun == ["ann", "bob"]
        tasks[5].cancel()
        end.set()
        await asyncio.gather(*tasks, return_exceptions=True)

    asyncio.run(main())
    assert begun.count("ann") == 19 and [*folder.iterdir()] == []


def test_who_waits_is_told_that_the_disk_refuses(folder: Path) -> None:
    """And the next one waits for a turn as ever."""

    async def main() -> None:
        turns = Turns(budget(folder, processes=1))
        kind = turns.kind(GIB)
        async with kind("ann"):
            waiting = asyncio.create_task(kind("bob").__aenter__())
            while len([*folder.iterdir()]) < 2:
                await asyncio.sleep(0.01)
            lock = folder.with_name("children.lock")
            lock.unlink()
            lock.mkdir()
            with pytest.raises(OSError):
                await waiting
            lock.rmdir()
        async with kind("bob"):
            pass

    asyncio.run(main())
