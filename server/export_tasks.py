"""Exports under way, and those that have failed; what is ready lies on the disk."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field

from server.children import Children, Meet
from server.problems import ProblemError, as_problem
from worker.exporting import ExportFailed
from worker.job import Problem

MOST = 100
"""Exports that may be under way, most of them waiting for their turn."""

Watch = Callable[[float], None]


@dataclass
class ExportTask:
    """An export that is under way, or has failed.

    Attributes:
        job_id: Its job.
        progress: Share that is done, from 0 to 1.
        problem: Why it has failed, if it has.
    """

    job_id: str
    progress: float = 0.0
    problem: Problem | None = None
    process: subprocess.Popen[bytes] | None = field(default=None, repr=False)
    task: asyncio.Task[None] | None = field(default=None, repr=False)

    def watch(self, progress: float) -> None:
        """Note how far it has come."""
        self.progress = progress


class ExportTasks:
    """All of them, by the id of the export.

    Args:
        limit: How many are made at the same time.
    """

    def __init__(self, limit: int) -> None:
        self._children = Children(limit)
        self._tasks: dict[str, ExportTask] = {}

    def get(self, export_id: str) -> ExportTask | None:
        """One that is under way or has failed since this process began."""
        return self._tasks.get(export_id)

    def start(self, export_id: str, job_id: str, make: Callable[[Watch, Meet], None]) -> ExportTask:
        """Begin with an export, unless it is under way.

        Raises:
            ProblemError: 429, there are too many.
        """
        known = self._tasks.get(export_id)
        if known is not None and known.problem is None:
            return known
        if len(self._tasks) >= MOST:
            self._forget_failed()
        if len(self._tasks) >= MOST:
            raise ProblemError(
                429,
                f"{MOST} exports are under way.",
                "Wait for some to finish.",
                headers={"Retry-After": "10"},
            )
        entry = self._tasks[export_id] = ExportTask(job_id)
        entry.task = asyncio.create_task(self._make(export_id, entry, make))
        return entry

    def forget(self, job_id: str) -> None:
        """End the exports of a job that is deleted."""
        for entry in list(self._tasks.values()):
            if entry.job_id == job_id and entry.process is not None:
                entry.process.kill()

    def close(self) -> None:
        """End all of them."""
        self._children.close()

    async def _make(
        self, export_id: str, entry: ExportTask, make: Callable[[Watch, Meet], None]
    ) -> None:
        def work(meet: Meet) -> None:
            def meet_here(process: subprocess.Popen[bytes]) -> None:
                entry.process = process
                meet(process)

            make(entry.watch, meet_here)

        try:
            await self._children.run(work)
            del self._tasks[export_id]
        except ExportFailed as failure:
            entry.problem = failure.problem
        except Exception as error:
            told = as_problem(error)
            entry.problem = Problem(cause=told.detail, remedy=told.remedy, kind="internal")

    def _forget_failed(self) -> None:
        for export_id in [i for i, entry in self._tasks.items() if entry.problem is not None]:
            del self._tasks[export_id]
