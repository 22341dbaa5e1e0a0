"""Exports under way, and those that have failed; what is ready lies on the disk."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from chamfer_morph.schemas import Problem
from chamfer_morph.server.child_pool import Children, Meet
from chamfer_morph.server.http.problems import ProblemError, as_problem
from chamfer_morph.worker.tasks.make_export import ExportFailed

MOST_PER_KEY = 20
"""Exports of a key that may be under way or waiting for their turn."""

FAILED = 100
"""Failed exports that are remembered."""

Watch = Callable[[float], None]


@dataclass
class ExportTask:
    """An export that is under way, or has failed.

    Attributes:
        path: Where it will be, less the ending of its name.
        owner: The key whose job it is.
        progress: Share that is done, from 0 to 1.
        problem: Why it has failed, if it has.
    """

    path: Path
    owner: str
    progress: float = 0.0
    problem: Problem | None = None
    task: asyncio.Task[None] | None = field(default=None, repr=False)

    def watch(self, progress: float) -> None:
        """Note how far it has come."""
        self.progress = progress


class ExportTasks:
    """All of them, by path.

    Args:
        limit: How many are made at the same time.
    """

    def __init__(self, limit: int) -> None:
        self._children = Children(limit)
        self._tasks: dict[Path, ExportTask] = {}

    def get(self, path: Path) -> ExportTask | None:
        """One that is under way or has failed since this process began."""
        return self._tasks.get(path)

    def start(self, path: Path, owner: str, make: Callable[[Watch, Meet], None]) -> None:
        """Begin with an export, unless it is under way.

        Raises:
            ProblemError: 429, the key has too many.
        """
        known = self._tasks.get(path)
        if known is not None and known.problem is None:
            return
        running = [entry for entry in self._tasks.values() if entry.problem is None]
        if sum(entry.owner == owner for entry in running) >= MOST_PER_KEY:
            raise ProblemError(
                429,
                f"{MOST_PER_KEY} exports of this key are under way.",
                "Wait for some to finish.",
                headers={"Retry-After": "10"},
            )
        self._forget_failed()
        entry = self._tasks[path] = ExportTask(path, owner)
        entry.task = asyncio.create_task(self._make(entry, make))

    def end(self, folder: Path) -> None:
        """End and forget the exports in a folder, or the one of which the path is given."""
        for path in [path for path in self._tasks if path.is_relative_to(folder)]:
            del self._tasks[path]
        self._children.end(folder)

    def close(self) -> None:
        """End all of them."""
        self._children.close()

    async def _make(self, entry: ExportTask, make: Callable[[Watch, Meet], None]) -> None:
        try:
            await self._children.run(entry.path, lambda meet: make(entry.watch, meet))
            if self._tasks.get(entry.path) is entry:
                del self._tasks[entry.path]
        except ExportFailed as failure:
            entry.problem = failure.problem
        except Exception as error:
            told = as_problem(error)
            kind = "resources" if told.status < 500 else "internal"
            entry.problem = Problem(cause=told.detail, remedy=told.remedy, kind=kind)

    def _forget_failed(self) -> None:
        """Forget the oldest of those that have failed."""
        failed = [path for path, entry in self._tasks.items() if entry.problem is not None]
        for path in failed[: max(len(failed) - FAILED, 0)]:
            del self._tasks[path]
