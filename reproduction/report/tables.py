"""Numbers side by side: printed in the paper, of the published program, and ours."""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from chamfer_morph.reproduction.experiments.experiment import Experiment, Row
from chamfer_morph.reproduction.published import numbers
from chamfer_morph.reproduction.runs.store import Record
from morph_engine.metrics.definitions import METRICS

COLUMNS = (
    "row", "metric", "printed", "published_program", "ours", "standard_deviation", "repeats",
    "minus_printed", "minus_program", "best", "run_ids", "config_digests", "code_digests",
    "version", "problem",
)  # fmt: skip

METRIC_NAMES = {
    "s2t": "s→t",
    "t2s": "t→s",
    "two_sided": "two-sided",
    "two_sided_over_h": "two-sided / h",
    "ratio": "ratio",
    "hausdorff": "Hausdorff",
    "f1": "F1",
    "iou": "IoU",
    "overlap_01": "overlap < .01",
    "overlap_floor": "least overlap (N-M+1)/N",
    "overlap_h10": "overlap < h/10",
    "many_to_one": "many-to-one",
    "targets_used": "targets used",
    "rho_p05": "density 5%",
    "rho_p50": "density 50%",
    "rho_p95": "density 95%",
    "rho_p99": "density 99%",
    "dense_t2s": "t→s",
    "dense_floor": "t→s, floor",
    "dense_s2t": "s→t",
    "dense_s2t_floor": "s→t, floor",
    "mesh_iou_level": "IoU with the mesh",
    "density_p05": "density 5%",
    "density_p95": "density 95%",
    "surface_mean": "surface",
    "outside_max": "farthest outside",
    "least_gap_ever": "least gap / h",
    "det_f_min_ever": "least det F",
    "det_f_max_ever": "greatest det F",
    "max_move_ever": "farthest move",
    "max_speed@0": "speed in frame 0",
    "max_speed@1": "frame 1",
    "max_speed@2": "frame 2",
    "cpu_seconds": "CPU time [s]",
}

FLOOR = "overlap_floor"
"""The column of `coincidence_floor`."""

NOT_COMPETING = {FLOOR, "ratio", "dense_floor", "dense_s2t_floor", "cpu_seconds"}
"""Columns that tell where others end, or follow from them."""

VERSION = "chamfer-morph"
"""The software whose version a number depends on first."""


@dataclass(frozen=True)
class Cell:
    """One number.

    Attributes:
        printed: In the paper; None where it has none.
        program: Of the published program, likewise.
        ours: Mean over our runs; None if one of them is missing.
        deviation: Standard deviation over repeats; None without.
        is_best: Whether ours is the best of its group.
        is_failed: Whether ours is missing because a run failed.
    """

    printed: float | None = None
    program: float | None = None
    ours: float | None = None
    deviation: float | None = None
    is_best: bool = False
    is_failed: bool = False

    @property
    def minus_printed(self) -> float | None:
        """Ours - printed."""
        return _difference(self.ours, self.printed)

    @property
    def minus_program(self) -> float | None:
        """Ours - the published program's."""
        return _difference(self.ours, self.program)


@dataclass(frozen=True)
class TableRow:
    """A row with its numbers by metric, and the records they come from."""

    row: Row
    cells: Mapping[str, Cell]
    records: tuple[Record, ...]

    @property
    def problem(self) -> str:
        """Why a number is missing; empty if none is."""
        failed = [record.problem for record in self.records if not record.is_complete]
        if failed:
            return failed[0]
        missing, count = len(self.row.runs) - len(self.records), len(self.row.runs)
        if not missing:
            return ""
        return "Not run yet." if missing == count else f"Not run yet: {missing} of {count} seeds."


@dataclass(frozen=True)
class Table:
    """The numbers of an experiment."""

    experiment: Experiment
    lines: tuple[TableRow, ...]

    @cached_property
    def _by_label(self) -> dict[str, TableRow]:
        return {line.row.label: line for line in self.lines}

    def cell(self, label: str, metric: str) -> Cell:
        """A number by row and metric; an empty cell if there is none."""
        line = self._by_label.get(label)
        return line.cells.get(metric, Cell()) if line else Cell()

    def ours(self, label: str, metric: str) -> float | None:
        """Our number by row and metric; None if there is none."""
        return self.cell(label, metric).ours

    def numbers(self, metric: str, labels: Iterable[str] | None = None) -> dict[str, float]:
        """Our numbers by row, of all rows or of some; rows without one are left out."""
        found = {
            label: self.ours(label, metric)
            for label in (self._by_label if labels is None else labels)
        }
        return {label: value for label, value in found.items() if value is not None}

    def pairs(
        self, names: Iterable[str], first: str, second: str, metric: str
    ) -> dict[str, tuple[float, float]]:
        """Our numbers of two rows for each name, where there are both; labels have {} for it."""
        found = {}
        for name in names:
            a, b = (self.ours(label.format(name), metric) for label in (first, second))
            if a is not None and b is not None:
                found[name] = a, b
        return found

    @property
    def groups(self) -> list[str]:
        """Groups of rows that compete, in order."""
        return list(dict.fromkeys(line.row.group for line in self.lines))

    @property
    def is_complete(self) -> bool:
        """Whether every run has come to its end."""
        return not any(line.problem for line in self.lines)

    def csv(self) -> str:
        """A line a number, with where it comes from."""
        lines = (
            _csv_row(line, metric, cell)
            for line in self.lines
            for metric, cell in line.cells.items()
        )
        return csv_text(COLUMNS, lines)

    @property
    def display_rows(self) -> list[tuple[str, str, Mapping[str, Cell]]]:
        """Name, remark and numbers by metric of each row."""
        return [
            (line.row.label, line.problem or line.row.remark, line.cells) for line in self.lines
        ]


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Rows under the names of their columns, as a CSV file has them."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def tabulate(experiment: Experiment, records: Mapping[str, Record]) -> Table:
    """Fill the table of an experiment with what there is, by run id."""
    lines = [_line(experiment, row, records) for row in experiment.rows]
    if "ratio" in experiment.metrics:
        lines = _with_ratios(lines)
    if FLOOR in experiment.metrics:
        lines = [_with_floor(line) for line in lines]
    for metric in set(experiment.metrics) - NOT_COMPETING:
        for group in {row.group for row in experiment.rows}:
            _mark_best(lines, metric, group)
    return Table(experiment, tuple(lines))


def _line(experiment: Experiment, row: Row, records: Mapping[str, Record]) -> TableRow:
    found = tuple(records[run.id] for run in row.runs if run.id in records)
    complete = [record for record in found if record.is_complete]
    in_paper = numbers.PAPER.get(experiment.printed_in or experiment.name, {}).get(row.label, {})
    in_program = numbers.PROGRAM.get(row.runs[0].id, {})
    cells = {}
    for metric in experiment.metrics:
        measured = [_numbers(record, experiment) for record in complete]
        values = [numbers[metric] for numbers in measured if metric in numbers]
        is_whole = len(values) == len(row.runs)
        cells[metric] = Cell(
            printed=in_paper.get(metric),
            program=in_program.get(metric),
            ours=statistics.fmean(values) if is_whole else None,
            deviation=statistics.stdev(values) if is_whole and len(values) > 1 else None,
            is_failed=not is_whole and len(complete) < len(found),
        )
    return TableRow(row, cells, found)


def _numbers(record: Record, experiment: Experiment) -> Mapping[str, float]:
    """The numbers of a finished run that an experiment may show: name@3 is that of frame 3."""
    if experiment.by_mesh:
        return record.ends[0] if record.ends else {}
    of_frames = {
        f"{name}@{frame}": value
        for name, curve in record.curves.items()
        for frame, value in enumerate(curve)
    }
    return {**record.metrics, **of_frames, "cpu_seconds": record.provenance.cpu_seconds}


def _with_ratios(lines: Sequence[TableRow]) -> list[TableRow]:
    """The lines with the ratio of each row's two-sided distance to that of the row it is over."""
    distances = {line.row.label: line.cells["two_sided"] for line in lines}
    filled = []
    for line in lines:
        cell, other = line.cells["two_sided"], distances.get(line.row.over, Cell())
        ratio = cell.ours / other.ours if cell.ours is not None and other.ours else None
        is_failed = line.cells["ratio"].is_failed and bool(line.row.over)
        found = replace(line.cells["ratio"], ours=ratio, deviation=None, is_failed=is_failed)
        filled.append(replace(line, cells={**line.cells, "ratio": found}))
    return filled


def _with_floor(line: TableRow) -> TableRow:
    """The line with the least share of coinciding particles that its numbers of points allow."""
    floors = {
        coincidence_floor(record.particle_count, record.target_count)
        for record in line.records
        if record.particle_count
    }
    cell = Cell(ours=max(floors)) if floors else Cell()
    return replace(line, cells={**line.cells, FLOOR: cell})


def coincidence_floor(particles: int, points: int) -> float:
    """Least share of N particles that share a place when all sit on M target points.

    Where they outnumber the points, it is least if one point has all that are too many and each
    other point one particle: (N - M + 1) / N. Where they do not, none has to share.
    """
    return (particles - points + 1) / particles if particles > points else 0.0


def _mark_best(lines: list[TableRow], metric: str, group: str) -> None:
    """Mark the best number of a group, where at least two compete."""
    distances = {
        index: distance_from_ideal(metric, value)
        for index, line in enumerate(lines)
        if line.row.group == group
        and (value := line.cells[metric].ours) is not None
        and math.isfinite(value)
    }
    for index, distance in distances.items():
        if len(distances) > 1 and distance == min(distances.values()):
            line = lines[index]
            cell = replace(line.cells[metric], is_best=True)
            lines[index] = replace(line, cells={**line.cells, metric: cell})


def distance_from_ideal(metric: str, value: float) -> float:
    """A number that is the smaller the better a metric's value is."""
    name = metric.removesuffix("_ever")
    better = METRICS[name].better if name in METRICS else "lower"
    if better == "one":
        return abs(math.log(value)) if value > 0 else math.inf
    return value if better == "lower" else -value


def _csv_row(line: TableRow, metric: str, cell: Cell) -> list[object]:
    return [
        line.row.label,
        metric,
        *map(format_exact, (cell.printed, cell.program, cell.ours, cell.deviation)),
        len(line.row.runs),
        *map(format_exact, (cell.minus_printed, cell.minus_program)),
        "yes" if cell.is_best else "",
        " ".join(run.id for run in line.row.runs),
        " ".join(record.digest for record in line.records),
        " ".join(sorted({record.provenance.code for record in line.records} - {""})),
        " ".join(sorted({record.software.get(VERSION, "") for record in line.records})),
        line.problem,
    ]


def format_exact(value: float | None) -> str:
    """A number for a file: seven digits, empty for None."""
    return "" if value is None else f"{value:.7g}"


def format_number(value: float | None) -> str:
    """A number for a reader: three decimals as the paper prints them, empty for None."""
    return "" if value is None else f"{value:.3f}"


def format_difference(value: float | None) -> str:
    """A difference for a reader, with its sign."""
    if value is None:
        return ""
    text = f"{value:+.3f}"
    return text.replace("-", "−") if float(text) else "0.000"


def _difference(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b
