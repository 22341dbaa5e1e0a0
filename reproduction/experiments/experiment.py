"""An experiment: a table of the paper or one it lacks, as rows of runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from chamfer_morph.reproduction.runs.run import Run


@dataclass(frozen=True)
class Row:
    """A row of a table.

    Attributes:
        label: Its name, by which printed numbers are found.
        runs: What it is computed from; several runs differ in their seed and are averaged.
        group: Rows of one group compete for the best number; empty is the whole table.
        remark: What a reader must know of this row.
        over: Label of the row by whose two-sided distance this row's is divided, in the column
            `ratio`; empty without one.
    """

    label: str
    runs: tuple[Run, ...]
    group: str = ""
    remark: str = ""
    over: str = ""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A table, its figures and what they show.

    Attributes:
        name: What `morph reproduce` calls it.
        title: Heading in the report.
        origin: Where it stands in the paper.
        rows: Rows in order; a run may serve several experiments.
        metrics: Columns.
        remarks: What a reader must know, a sentence each.
        printed_in: The experiment whose printed numbers the rows have, by their labels; empty for
            its own.
        has_table: Whether there is a table, not figures alone.
        by_mesh: Whether its numbers are those of `Record.ends`, by points that no method has seen,
            and not those that the runs have measured themselves.
        in_all: Whether it is a part of `morph reproduce all`.
    """

    name: str
    title: str
    origin: str = "not in the paper"
    rows: tuple[Row, ...]
    metrics: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    printed_in: str = ""
    has_table: bool = True
    by_mesh: bool = False
    in_all: bool = True

    @property
    def runs(self) -> tuple[Run, ...]:
        """All runs, each once."""
        return distinct(run for row in self.rows for run in row.runs)

    def quick(self) -> Experiment:
        """The same with the preset `fast`, and a title that says so."""
        rows = tuple(replace(row, runs=tuple(run.quick() for run in row.runs)) for row in self.rows)
        if rows == self.rows:
            return self
        remark = "Quick: physics and joint ran with the preset fast instead of published."
        return replace(
            self, title=f"{self.title} (quick)", rows=rows, remarks=(remark, *self.remarks)
        )


def distinct(runs: Iterable[Run]) -> tuple[Run, ...]:
    """Runs without repetitions, in order."""
    return tuple({run.id: run for run in runs}.values())
