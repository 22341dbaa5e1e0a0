"""The memory and the processes that the children on this machine share, whichever API starts them.

Each child, and each that waits for its turn, is a file in a folder, whose suffix tells which of the
two it is. The file is locked as long as the process lives that made it, so that what a killed one
held is free at once. One process at a time looks for what may begin, under the lock of the folder.
"""

from __future__ import annotations

import json
import os
import re
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass
from itertools import count
from pathlib import Path
from typing import BinaryIO

from chamfer_morph.worker.settings import Settings
from morph_engine.files import acquire, wait_for
from morph_engine.machine_memory import total_memory

WAITING, RUNNING = ".waiting", ".running"

_numbers = count()


@dataclass(frozen=True)
class Demand:
    """A child that somebody wants.

    Attributes:
        owner: Name of the key on whose account it is.
        memory_bytes: Memory that it may take [bytes].
        long: Whether it may take longer than somebody wants to wait for a short one.
    """

    owner: str
    memory_bytes: int
    long: bool


class Ticket:
    """A demand that has been entered, until it is closed."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file

    @property
    def name(self) -> str:
        """What tells it from all others."""
        return self._path.stem

    def begin(self) -> None:
        """Its turn has come; under the lock of the folder."""
        with suppress(FileNotFoundError):  # closed meanwhile
            self._path = self._path.rename(self._path.with_suffix(RUNNING))

    def close(self) -> None:
        """The child has ended, or nobody wants it any more."""
        self._path.unlink(missing_ok=True)
        self._file.close()


class Budget:
    """What children may take together. Calls block, for moments; any thread may make them.

    A key always leaves one process and `reserve_bytes` to others, and so do long children to short
    ones: what is asked for in passing waits for nobody's exports, nor for all that another key has
    asked for.

    Args:
        folder: Where the demands of all processes lie.
        processes: Children at the same time.
        memory_bytes: Memory of all of them [bytes].
        reserve_bytes: Memory of a short child [bytes].
    """

    def __init__(
        self, folder: Path, *, processes: int, memory_bytes: int, reserve_bytes: int
    ) -> None:
        self._folder = folder
        self._gate = folder.with_name(f"{folder.name}.lock")
        self._in_process = threading.Lock()
        self._processes = processes
        self._memory_bytes = memory_bytes
        self._reserve_bytes = min(reserve_bytes, memory_bytes // 2)

    @classmethod
    def of(cls, settings: Settings) -> Budget:
        """The budget of this machine."""
        host = re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname())
        return cls(
            settings.data_dir / "locks" / f"children-{host}",
            processes=settings.sandbox_processes,
            memory_bytes=settings.sandbox_memory_bytes or total_memory(),
            reserve_bytes=settings.inspect_memory_bytes,
        )

    @property
    def largest_bytes(self) -> int:
        """Memory that a single child may take [bytes]."""
        return self._memory_bytes - self._reserve_bytes

    def enter(self, demand: Demand) -> Ticket:
        """Get in line.

        Raises:
            OSError: The disk is full.
        """
        name = f"{time.time_ns():020}-{os.getpid()}-{next(_numbers)}{WAITING}"
        with self._locked():
            path = self._folder / name
            file = acquire(path)
            assert file is not None, "nobody else makes a file of this name"
            ticket = Ticket(path, file)
            try:
                file.write(json.dumps(astuple(demand)).encode())
                file.flush()
            except OSError:
                ticket.close()
                raise
        return ticket

    def begin(self, mine: Sequence[Ticket]) -> list[Ticket]:
        """Those of our tickets whose turn has come; they run from now on.

        The key with the fewest children is first, then who has waited longest. What has to wait for
        room is overtaken by what has room.
        """
        with self._locked():
            running, waiting = self._entered()
            own = {ticket.name: ticket for ticket in mine}
            begun = []
            while waiting and len(running) < self._processes:
                held = Counter(demand.owner for demand in running)
                name = min(waiting, key=lambda name: (held[waiting[name].owner], name))
                demand = waiting.pop(name)
                if not self._has_room(demand, running):
                    continue
                running.append(demand)
                if ticket := own.get(name):
                    ticket.begin()
                    begun.append(ticket)
        return begun

    def _has_room(self, demand: Demand, running: Sequence[Demand]) -> bool:
        """Whether a child may begin beside others, with what is to be left."""
        own = [other for other in running if other.owner == demand.owner]
        return self._fits(demand, own, leaving=True) and self._fits(
            demand, running, leaving=demand.long
        )

    def _fits(self, demand: Demand, others: Sequence[Demand], *, leaving: bool) -> bool:
        reserved = leaving and self._processes > 1
        processes = self._processes - len(others) - 1 - reserved
        memory = self._memory_bytes - sum(other.memory_bytes for other in others)
        memory -= demand.memory_bytes + leaving * self._reserve_bytes
        return min(processes, memory) >= 0

    def _entered(self) -> tuple[list[Demand], dict[str, Demand]]:
        """What runs, and what waits, by names that tell when it came."""
        running: list[Demand] = []
        waiting: dict[str, Demand] = {}
        for path in self._folder.iterdir():
            if abandoned := acquire(path):
                path.unlink(missing_ok=True)
                abandoned.close()
                continue
            with suppress(OSError, ValueError):  # it has ended meanwhile
                demand = Demand(*json.loads(path.read_bytes()))
                if path.suffix == RUNNING:
                    running.append(demand)
                else:
                    waiting[path.stem] = demand
        return running, waiting

    @contextmanager
    def _locked(self) -> Iterator[None]:
        self._folder.mkdir(exist_ok=True)
        with self._in_process, wait_for(self._gate):  # threads need not poll for the file
            yield
