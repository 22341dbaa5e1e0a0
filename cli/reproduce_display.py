"""A reproduction while it lasts, live on standard error, and its tables on standard output."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from itertools import groupby

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn
from rich.table import Table
from rich.text import Text

from chamfer_morph.cli.progress_display import ProgressDisplay
from chamfer_morph.cli.tables import PIPED_WIDTH, format_duration
from chamfer_morph.reproduction.report.section import DisplayTable, Section
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.runner import Progress as RunProgress
from chamfer_morph.reproduction.runs.store import Record
from morph_engine.machine_cores import usable_cores

SETTLED_SHARE = 0.02
"""From here on the time left follows from what has been measured, not from the estimate."""


class ReproductionDisplay(ProgressDisplay):
    """A line for the whole and one for each run under way; elsewhere a line per finished run.

    Until something has been measured, the time left follows from the number of jobs at a time.
    """

    def __init__(self, *, jobs: int, quiet: bool) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            quiet=quiet,
        )
        self._jobs = jobs
        self._whole = self._progress.add_task("all", total=1.0, note="")
        self._tasks: dict[str, TaskID] = {}
        self._printed: set[str] = set()
        self._begun = time.monotonic()
        self._done_at_first: float | None = None

    def show(self, progress: RunProgress) -> None:
        """Show how far the runs have come."""
        left = format_duration(self._seconds_left(progress))
        counts = f"{len(progress.finished)}/{len(progress.runs)} runs"
        for run_id, record in progress.finished.items():
            if run_id not in self._printed:
                self._printed.add(run_id)
                self.print(f"{counts}  {_outcome(record)}  left {left}")
        share = progress.cost_done / progress.cost if progress.runs else 1.0
        self._progress.update(self._whole, completed=share, note=f"{counts}  left {left}")
        frames = {run.id: run.frames for run in progress.runs}
        for run_id in self._tasks.keys() - progress.frames.keys():
            self._progress.remove_task(self._tasks.pop(run_id))
        for run_id, done in progress.frames.items():
            if run_id not in self._tasks:
                self._tasks[run_id] = self._progress.add_task(run_id, total=frames[run_id], note="")
            note = f"frame {done}/{frames[run_id]}" if done else "starting"
            self._progress.update(self._tasks[run_id], completed=done, note=note)

    def _seconds_left(self, progress: RunProgress) -> float:
        if self._done_at_first is None:
            self._done_at_first = progress.cost_done  # frames of an earlier attempt cost no time
        done = progress.cost_done - self._done_at_first
        left = progress.cost - progress.cost_done
        if done > SETTLED_SHARE * progress.cost:
            return left * (time.monotonic() - self._begun) / done
        return left / self._jobs


class EndsDisplay(ProgressDisplay):
    """A line for the ends that are measured against meshes; elsewhere a line for every tenth."""

    def __init__(self, *, quiet: bool) -> None:
        super().__init__(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), quiet=quiet
        )
        self._task: TaskID | None = None

    def show(self, done: int, total: int) -> None:
        """Show how many have been measured."""
        if self._task is None:
            self._task = self._progress.add_task("ends measured", total=total)
        self._progress.update(self._task, completed=done)
        if not self._console.is_terminal and (done == total or done % 10 == 0):
            self.print(f"{done}/{total} ends measured")


def print_plan(
    missing: Sequence[Run], *, known: int, outdated: int, jobs: int, server: str | None
) -> None:
    """Print on standard error what is about to be computed, and how long that takes about.

    So many runs are known, and so many of the missing ones are there, but of other code.
    """
    cost = sum(run.expected_cpu_seconds for run in missing)
    plan = f"{len(missing)} runs to compute, {known} already computed."
    if missing and server is None:
        cores = min(jobs, usable_cores())
        duration = format_duration(cost / cores)
        plan += f" About {format_duration(cost)} of CPU time, {duration} with {jobs} at a time."
    elif missing:
        plan += f" About {format_duration(cost)} of CPU time, by {server}."
    sys.stderr.write(f"{plan}\n")
    if outdated:
        sys.stderr.write(
            f"{outdated} of them were computed by other or unknown code: use --any-code to "
            "accept such runs.\n"
        )


def print_section(section: Section) -> None:
    """A section of the report on standard output."""
    width = None if sys.stdout.isatty() else PIPED_WIDTH
    console = Console(highlight=False, width=width)
    console.print(Text(f"\n{section.title} ({section.origin})", style="bold"))
    if section.table:
        console.print(_table(section.table))
    for sentence in section.findings:
        console.print(Text(sentence))


def _table(shown: DisplayTable) -> Table:
    """A line per number: printed, published program, ours, difference."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("row", overflow="fold")
    table.add_column("metric", no_wrap=True)
    kinds = list(dict.fromkeys(kind for _, kind in shown.columns))
    for kind in kinds:
        table.add_column(kind, justify="right", no_wrap=True)
    for name, _, cells in shown.rows:
        lines = groupby(zip(shown.columns, cells, strict=True), key=lambda pair: pair[0][0])
        for index, (heading, pairs) in enumerate(lines):
            texts = dict.fromkeys(kinds, Text(""))
            for (_, kind), cell in pairs:
                text = f"{cell.text} *" if cell.is_best else cell.text
                texts[kind] = Text(text, style="bold" if cell.is_best else "")
            table.add_row(Text("" if index else name), Text(heading), *texts.values())
    return table


def _outcome(record: Record) -> str:
    if not record.is_complete:
        return f"{record.run.id} failed: {record.problem}"
    return f"{record.run.id}  CD {record.metrics['two_sided']:.4f}"
