"""Figures made of numbers: curves over frames, scatter of the pairs, printed against ours."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import NullFormatter

from chamfer_morph.reproduction.published.numbers import SHAPES, TARGETS
from chamfer_morph.reproduction.report.tables import Cell, Table, TableRow
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.store import Record
from morph_engine.metrics.definitions import METRICS

# Okabe and Ito: told apart by readers with any common colour vision
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#8A8A8A"

COLORS = {
    "physics": BLUE,
    "joint": VERMILION,
    "dco": BLACK,
    "dcd": ORANGE,
    "density_aware": PURPLE,
    "shared_basis": GREEN,
}
MARKERS = dict(zip(SHAPES, "osD^v", strict=True))
NAMES = {
    "s2t": "s→t",
    "t2s": "t→s",
    "two_sided": "two-sided distance",
    "f1": "F1",
    "overlap_01": "share closer than 0.01 to another",
    "overlap_h10": "share closer than h/10 to another",
}

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,  # of 7.2 inches: still legible at half the width
    "axes.titlesize": 11,
    "axes.labelsize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "errorbar.capsize": 3,
    "lines.linewidth": 1.9,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.hashsalt": "reproduction",
}


@contextmanager
def style() -> Iterator[None]:
    """Within, figures have the house style."""
    with matplotlib.rc_context(STYLE):
        yield


def name_of(metric: str) -> str:
    """A metric for an axis, with its unit where it is a length."""
    text = NAMES.get(metric, metric)
    unit = METRICS[metric].unit
    return f"{text} [{unit}]" if unit in ("dx", "h") else text


def convergence(table: Table, metric: str) -> Figure:
    """A metric over frames, a panel per target and a curve per row."""
    with style():
        figure = Figure(figsize=(7.2, 5.2), layout="constrained")
        panels = figure.subplots(2, 2, sharex=True)
        for axes, target in zip(panels.ravel(), TARGETS, strict=True):
            for line in table.lines:
                name, _, label = line.row.label.partition(", ")
                if name == target:
                    _curve(axes, line, metric, label=label)
            axes.set(title=f"Sphere → {target}")
            _log_scale(axes)
        for axes in panels[1]:
            axes.set_xlabel("frame")
        for axes in panels[:, 0]:
            axes.set_ylabel(name_of(metric))
        _legend(figure, panels[0, 0])
    return figure


def curves(table: Table, metrics: tuple[str, ...]) -> Figure:
    """Metrics over frames, a column each and a curve per table row; runs of a length share panels.

    So runs that were given time to converge neither squeeze the others nor look like them.
    """
    groups: dict[int, list[TableRow]] = {}
    for line in table.lines:
        groups.setdefault(line.row.runs[0].frames, []).append(line)
    heights = [3.0 + 0.24 * -(-len(lines) // 2) for lines in groups.values()]
    with style():
        figure = Figure(figsize=(7.2, sum(heights)), layout="constrained")
        parts = figure.subfigures(len(groups), 1, squeeze=False, height_ratios=heights)[:, 0]
        for part, lines in zip(parts, groups.values(), strict=True):
            panels = part.subplots(1, len(metrics), squeeze=False)[0]
            for axes, metric in zip(panels, metrics, strict=True):
                for line in lines:
                    _curve(axes, line, metric, label=line.row.label)
                axes.set(xlabel="frame", title=name_of(metric))
                if METRICS[metric].unit == "dx":
                    _log_scale(axes)
            _legend(part, panels[0], columns=2)
    return figure


def _legend(figure: FigureBase, axes: Axes, *, columns: int = 3) -> None:
    """Name the curves of a panel below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def _curve(axes: Axes, line: TableRow, metric: str, *, label: str) -> None:
    for record in line.records[:1]:
        values = record.curves.get(metric)
        if record.is_complete and values:
            color, dashes = color_of(record), _dashes(line.row.runs[0])
            taken = {(other.get_color(), other.get_linestyle()) for other in axes.get_lines()}
            if (color, dashes) in taken:
                dashes = ":"  # a second plain run of the same method
            axes.plot(values, label=label, color=color, linestyle=dashes)


def color_of(record: Record) -> str:
    """The colour of a run's method."""
    return COLORS.get(record.run.method, GREY)


def _dashes(run: Run) -> str | tuple[int, tuple[float, ...]]:
    """What sets variants of one method apart, beside the length of the run."""
    if run.points_per_cell_edge != 3:
        return "--"
    variants = run.overrides.keys() - {"descent.epsilon"}
    if "descent.epsilon" in run.overrides and run.frames <= 40:
        return "-."
    return (0, (4, 1, 1, 1)) if variants else "-"


def _log_scale(axes: Axes, which: Literal["x", "y"] = "y") -> None:
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    wanted = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 2, 5)
    ticks = [value for value in wanted if low <= value <= high]
    axis.set_ticks(ticks, labels=[f"{value:g}" for value in ticks])
    axis.set_minor_formatter(NullFormatter())


def scatter(table: Table) -> Figure:
    """Physics against joint, a point per pair; the marker tells the source, hollow is printed."""
    printed: Any = {
        "s": 26,
        "facecolors": "none",
        "edgecolors": GREY,
        "linewidths": 0.8,
        "zorder": 2,
    }
    ours: Any = {"s": 36, "facecolors": BLUE, "edgecolors": "white", "linewidths": 0.6, "zorder": 3}
    with style():
        figure = Figure(figsize=(4.8, 4.8), layout="constrained")
        axes = figure.subplots()
        values: list[float] = []
        for source in SHAPES:
            for origin, look in (("printed", printed), ("ours", ours)):
                points = _pair_points(table, source, origin)
                if points:
                    x, y = np.transpose(points)
                    values += [*x, *y]
                    axes.scatter(x, y, marker=MARKERS[source], **look)
        if values:
            low, high = 0.95 * min(values), 1.05 * max(values)
            axes.plot([low, high], [low, high], color=BLACK, linewidth=0.8, zorder=1)
            axes.fill_between([low, high], [low, high], low, color=GREEN, alpha=0.08, linewidth=0)
            words: Any = {"ha": "right", "va": "center", "color": GREEN}
            axes.text(0.98, 0.5, "joint is better", transform=axes.transAxes, **words)
            axes.set(xlim=(low, high), ylim=(low, high))
        for source in SHAPES:
            axes.scatter([], [], marker=MARKERS[source], color=BLUE, label=f"from {source}")
        axes.scatter([], [], marker="o", facecolors="none", edgecolors=GREY, label="printed")
        axes.set(
            xlabel="physics, two-sided distance [dx]",
            ylabel="joint, two-sided distance [dx]",
            aspect="equal",
        )
        axes.legend(loc="upper left")
    return figure


def _pair_points(table: Table, source: str, origin: str) -> list[tuple[float, float]]:
    points = []
    for target in SHAPES:
        x, y = (
            getattr(table.cell(f"{source} → {target}, {method}", "two_sided"), origin)
            for method in ("physics", "joint")
        )
        if x is not None and y is not None:
            points.append((x, y))
    return points


SQUEEZED = 3.0
"""Numbers that differ by more than this factor get a logarithmic axis: one does not squeeze all."""


def _shown(cell: Cell) -> list[float]:
    return [value for value in (cell.printed, cell.program, cell.ours) if value is not None]


def printed_against_ours(table: Table) -> Figure:
    """Each row's two-sided distance: printed, the published program's and ours, with its spread."""
    metric = "two_sided"
    lines = [line for line in table.lines if line.cells[metric].ours is not None]
    with style():
        figure = Figure(figsize=(7.2, 1.0 + 0.3 * max(3, len(lines))), layout="constrained")
        axes = figure.subplots()
        for place, line in enumerate(lines):
            cell = line.cells[metric]
            if cell.printed is not None:
                axes.plot(cell.printed, place, "o", mfc="white", mec=BLACK, ms=7, mew=1.1)
            if cell.program is not None:
                axes.plot(cell.program, place, "D", mfc="none", mec=GREEN, ms=6, mew=1.3)
            assert cell.ours is not None
            color = color_of(line.records[0])
            axes.errorbar(
                cell.ours, place, xerr=cell.deviation, fmt="o", color=color, ms=4, elinewidth=1.2
            )
        axes.set_yticks(range(len(lines)), [line.row.label for line in lines])
        axes.set_ylim(len(lines) - 0.5, -0.5)
        axes.set_xlabel(name_of(metric))
        axes.grid(axis="y", visible=False)
        found = [value for line in lines for value in _shown(line.cells[metric])]
        if found and max(found) > SQUEEZED * min(found):
            _log_scale(axes, "x")
        if any(line.cells[metric].printed is not None for line in lines):
            axes.plot([], [], "o", mfc="white", mec=BLACK, ms=7, label="printed")
        if any(line.cells[metric].program is not None for line in lines):
            axes.plot([], [], "D", mfc="none", mec=GREEN, ms=6, label="published program")
        axes.plot([], [], "o", color=GREY, ms=4, label="ours, coloured by method")
        figure.legend(loc="outside upper right", ncols=3)
    return figure
