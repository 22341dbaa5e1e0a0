"""A section of the report: words, one grid of numbers, figures, and where the numbers come from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from chamfer_morph.reproduction.report.figures import ReportFigure, draw_all
from chamfer_morph.reproduction.report.findings import findings
from chamfer_morph.reproduction.report.tables import (
    VERSION,
    Table,
    TableRow,
    format_difference,
    format_number,
)
from chamfer_morph.reproduction.runs.store import Record, Store

METRIC_NAMES = {
    "s2t": "s→t",
    "t2s": "t→s",
    "two_sided": "two-sided",
    "two_sided_over_h": "two-sided / h",
    "hausdorff": "Hausdorff",
    "f1": "F1",
    "iou": "IoU",
    "overlap_01": "overlap < .01",
    "overlap_h10": "overlap < h/10",
    "many_to_one": "many-to-one",
    "targets_used": "targets used",
    "rho_p05": "density 5%",
    "rho_p50": "density 50%",
    "rho_p95": "density 95%",
    "rho_p99": "density 99%",
    "surface_mean": "surface",
    "outside_max": "farthest outside",
    "least_gap_ever": "least gap / h",
    "det_f_min_ever": "least det F",
    "det_f_max_ever": "greatest det F",
    "max_move_ever": "farthest move",
}


@dataclass(frozen=True)
class DisplayCell:
    """What stands in one place of a grid."""

    text: str
    is_best: bool = False


@dataclass(frozen=True)
class DisplayTable:
    """A table as it is shown: columns under headings, rows that begin with their name.

    Attributes:
        headings: Heading and number of columns below it; the row names have none.
        columns: Names of the columns, headings apart.
        rows: Name, remark and entries of each row.
    """

    headings: tuple[tuple[str, int], ...]
    columns: tuple[str, ...]
    rows: tuple[tuple[str, str, tuple[DisplayCell, ...]], ...]


@dataclass(frozen=True)
class Provenance:
    """Where a number comes from.

    Attributes:
        run: Id of the run.
        digest: Of its configuration and meshes.
        config: Its preset and seed, in words.
        size: Particles and target points, frames.
        cost: CPU seconds.
        version: Of this software.
    """

    run: str
    digest: str
    config: str
    size: str
    cost: str
    version: str


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
        provenance: Where the numbers come from.
    """

    name: str
    title: str
    origin: str
    findings: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    table: DisplayTable | None = None
    csv: str = ""
    figures: tuple[ReportFigure, ...] = ()
    provenance: tuple[Provenance, ...] = ()


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
        table=display_table(table) if experiment.has_table else None,
        csv=table.csv(),
        figures=draw_all(table, store, figures),
        provenance=_sources(record for line in table.lines for record in line.records),
    )


def display_table(table: Table) -> DisplayTable:
    """Printed, published program, ours, difference; columns without any number are left out."""
    headings, columns = [], []
    wanted: list[tuple[str, tuple[str, ...]]] = []
    for metric in table.experiment.metrics:
        cells = [line.cells[metric] for line in table.lines]
        kinds: list[str] = []
        if any(cell.printed is not None for cell in cells):
            kinds.append("printed")
        if any(cell.program is not None for cell in cells):
            kinds.append("program")
        kinds.append("ours")
        if "printed" in kinds:
            kinds.append("difference")
        wanted.append((metric, tuple(kinds)))
        headings.append((METRIC_NAMES.get(metric, metric), len(kinds)))
        columns += kinds
    rows = tuple(
        (
            line.row.label,
            line.problem or line.row.remark,
            tuple(_entry(line, metric, kind) for metric, kinds in wanted for kind in kinds),
        )
        for line in table.lines
    )
    return DisplayTable(tuple(headings), tuple(columns), rows)


def _entry(line: TableRow, metric: str, kind: str) -> DisplayCell:
    cell = line.cells[metric]
    match kind:
        case "printed":
            return DisplayCell(format_number(cell.printed))
        case "program":
            return DisplayCell(format_number(cell.program))
        case "difference":
            return DisplayCell(format_difference(cell.minus_printed))
        case _:
            failed = cell.ours is None and any(not each.is_complete for each in line.records)
            text = "failed" if failed else format_number(cell.ours)
            if cell.deviation is not None:
                text += f" ± {cell.deviation:.3f}"
            return DisplayCell(text, cell.is_best)


def _sources(records: Iterable[Record]) -> tuple[Provenance, ...]:
    distinct = {record.run.id: record for record in records}
    return tuple(
        Provenance(
            run=record.run.id,
            digest=record.digest[:12],
            config=f"{record.config.get('preset', record.run.preset)}, seed {record.run.seed}",
            size=f"{record.particle_count} → {record.target_count}, {record.frames} frames"
            if record.is_complete
            else "failed",
            cost=f"{record.cpu_seconds:.0f} s" if record.is_complete else "",
            version=record.software.get(VERSION, ""),
        )
        for record in distinct.values()
    )
