"""A section of the report: words, a table of numbers, figures, and where the numbers come from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from chamfer_morph.reproduction.report.figures import ReportFigure, draw_all
from chamfer_morph.reproduction.report.findings import findings
from chamfer_morph.reproduction.report.sources import Source, sources
from chamfer_morph.reproduction.report.tables import (
    METRIC_NAMES,
    Cell,
    Table,
    format_difference,
    format_number,
)
from chamfer_morph.reproduction.runs.store import Store


@dataclass(frozen=True)
class DisplayCell:
    """What stands in one place of a table."""

    text: str
    is_best: bool = False


@dataclass(frozen=True)
class DisplayTable:
    """A table as it is shown: rows that begin with their name, columns in groups under a heading.

    Attributes:
        columns: Heading and name of each column; neighbours may share a heading.
        rows: Name, remark and cells of each row.
    """

    columns: tuple[tuple[str, str], ...]
    rows: tuple[tuple[str, str, tuple[DisplayCell, ...]], ...]


@dataclass(frozen=True)
class Section:
    """One table of the paper, or one that it lacks.

    Attributes:
        name: What `morph reproduce` calls it.
        title: Heading.
        origin: Where it stands in the paper.
        findings: What our numbers show.
        remarks: What a reader must know.
        table: The numbers; None where there are figures alone.
        csv: The numbers for a program; empty where there are none.
        figures: Its figures.
        sources: Where the numbers come from.
    """

    name: str
    title: str
    origin: str
    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    table: DisplayTable | None = None
    csv: str = ""
    figures: tuple[ReportFigure, ...] = ()
    sources: tuple[Source, ...] = ()


def section_of(table: Table, store: Store, figures: Path) -> Section:
    """The section of an experiment, its figures drawn into a folder.

    Raises:
        OSError: The folder cannot be written.
    """
    experiment = table.experiment
    return Section(
        name=experiment.name,
        title=experiment.title,
        origin=experiment.origin,
        findings=tuple(findings(table)),
        remarks=experiment.remarks,
        table=display_table(table.display_rows) if experiment.has_table else None,
        csv=table.csv(),
        figures=draw_all(table, store, figures),
        sources=sources(record for line in table.lines for record in line.records),
    )


def display_table(
    rows: Sequence[tuple[str, str, Mapping[str, Cell]]], names: Mapping[str, str] = METRIC_NAMES
) -> DisplayTable:
    """Printed, published program, ours, difference; columns without any number are left out.

    Rows have a name, a remark, and numbers by metric, all of the same metrics.
    """
    columns = [
        (metric, kind)
        for metric in rows[0][2]
        for kind in _kinds([cells[metric] for _, _, cells in rows])
    ]
    return DisplayTable(
        tuple((names.get(metric, metric), kind) for metric, kind in columns),
        tuple(
            (name, remark, tuple(_display_cell(cells[metric], kind) for metric, kind in columns))
            for name, remark, cells in rows
        ),
    )


def _kinds(cells: Sequence[Cell]) -> Iterator[str]:
    """The columns that a metric has."""
    is_printed = any(cell.printed is not None for cell in cells)
    if is_printed:
        yield "printed"
    if any(cell.program is not None for cell in cells):
        yield "program"
    yield "ours"
    if is_printed:
        yield "difference"


def _display_cell(cell: Cell, kind: str) -> DisplayCell:
    if kind == "printed":
        return DisplayCell(format_number(cell.printed))
    if kind == "program":
        return DisplayCell(format_number(cell.program))
    if kind == "difference":
        return DisplayCell(format_difference(cell.minus_printed))
    text = "failed" if cell.is_failed else format_number(cell.ours)
    if cell.deviation is not None:
        text += f" ± {cell.deviation:.3f}"
    return DisplayCell(text, cell.is_best)
