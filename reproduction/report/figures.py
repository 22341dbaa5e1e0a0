"""Which figures belong to which experiment, and their files."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure
from PIL import Image

from chamfer_morph.reproduction.published.numbers import TARGETS
from chamfer_morph.reproduction.report import charts
from chamfer_morph.reproduction.report.particle_images import (
    PointCloud,
    cross_sections,
    densities,
    frame_cloud,
    gallery,
    target_cloud,
)
from chamfer_morph.reproduction.report.tables import Table
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.store import Store
from morph_engine.errors import ResultError
from morph_engine.files import replacing

DOTS_PER_INCH = 200

DrawFunction = Callable[[Table, Store], Figure]


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the report, or the problem for which it could not be drawn."""

    name: str
    caption: str
    png: bytes = b""
    problem: str = ""


class FigureSpec(NamedTuple):
    """A figure that an experiment has."""

    name: str
    caption: str
    draw: DrawFunction


def draw_all(table: Table, store: Store, folder: Path) -> tuple[ReportFigure, ...]:
    """Draw the figures of an experiment into a folder, as PNG and SVG.

    A figure whose data are absent is left out and says what it lacks.

    Raises:
        OSError: The folder cannot be written.
    """
    figures = []
    for name, caption, draw in FIGURES.get(table.experiment.name, ()):
        stem = f"{table.experiment.name}-{name}"
        try:
            figures.append(save(draw(table, store), folder / stem, caption))
        except ResultError as error:
            why = str(error).replace(f"{store.folder}{os.sep}", "")
            figures.append(ReportFigure(stem, caption, problem=f"This figure is missing: {why}"))
    return tuple(figures)


def save(figure: Figure, path: Path, caption: str) -> ReportFigure:
    """Write a figure as path.png and path.svg."""
    path.parent.mkdir(parents=True, exist_ok=True)
    png, svg, smaller = io.BytesIO(), io.BytesIO(), io.BytesIO()
    with charts.style():
        figure.savefig(png, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
        figure.savefig(svg, format="svg", dpi=DOTS_PER_INCH, metadata={"Date": None})
    # 256 colours take a third of the space
    picture = Image.open(png).convert("RGB")
    few_colors = picture.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few_colors.save(smaller, "png", optimize=True)
    for kind, image in (("png", smaller), ("svg", svg)):
        with replacing(path.with_name(f"{path.name}.{kind}")) as temporary:
            temporary.write_bytes(image.getvalue())
    return ReportFigure(path.name, caption, smaller.getvalue())


def _run(table: Table, label: str) -> Run:
    """The run of a row, if it has a result.

    Raises:
        ResultError: It has none.
    """
    for line in table.lines:
        if line.row.label == label and line.records and line.records[0].is_complete:
            return line.row.runs[0]
    raise ResultError(f"{label} has no result.", "Repeat the command to compute it.")


def _clouds(
    table: Table, store: Store, labels: Iterable[str], titles: Iterable[str]
) -> list[PointCloud]:
    """The target, and the final particles of rows."""
    runs = [_run(table, label) for label in labels]
    target = target_cloud(store, runs[-1])
    return [target, *(frame_cloud(store, *named) for named in zip(runs, titles, strict=True))]


def _numbers(remark: str = "") -> FigureSpec:
    caption = "Printed numbers (hollow), the published program's (diamonds) and ours (filled)."
    return FigureSpec("numbers", caption + remark, lambda t, _: charts.printed_against_ours(t))


def _curves(caption: str, *metrics: str) -> FigureSpec:
    return FigureSpec("frames", caption, lambda table, _: charts.curves(table, metrics))


def _convergence(caption: str, metric: str) -> FigureSpec:
    return FigureSpec("frames", caption, lambda table, _: charts.convergence(table, metric))


def _finals(labels: Sequence[str], titles: Sequence[str], remark: str = "") -> FigureSpec:
    """A row of final shapes per target of the paper; labels have {} for the target."""

    def draw(table: Table, store: Store) -> Figure:
        rows = [(target, [label.format(target) for label in labels]) for target in TARGETS]
        return gallery([(name, _clouds(table, store, row, titles)) for name, row in rows])

    return FigureSpec("finals", _FINALS + remark, draw)


def _dragons(table: Table, store: Store) -> Figure:
    coarse = ["DCO, 3 per edge", "DCD, 3 per edge", "Physics, 3 per edge", "Joint, 3 per edge"]
    fine = ["DCO, 4 per edge", "Physics, 4 per edge", "Joint, 4 per edge, native settings"]
    titles = ["DCO", "DCD", "physics", "joint"]
    target, dco, *others = _clouds(table, store, fine, ["DCO", "physics", "joint"])
    above = _clouds(table, store, coarse, titles)
    return gallery([("3 per edge", above), ("4 per edge", [target, dco, None, *others])])


def _strips(table: Table, store: Store) -> Figure:
    """A film strip per row of the table: target, source, frames."""
    rows = []
    for line in table.lines:
        run = _run(table, line.row.label)
        last = line.records[0].frames - 1
        clouds = [target_cloud(store, run), frame_cloud(store, run, "source", None)]
        for frame in (3, 8, 15, last):
            shown = min(frame, last)
            clouds.append(frame_cloud(store, run, f"frame {shown}", shown))
        rows.append((line.row.label, clouds))
    return gallery(rows)


def _sections(*labels: str) -> FigureSpec:
    return FigureSpec(
        "sections",
        "Slices through the middle. Red particles lie closer than 0.01 to another one.",
        lambda table, store: cross_sections(_clouds(table, store, labels, labels)),
    )


def _densities(
    labels: Sequence[str], titles: Sequence[str] = (), *, before: str = "How", target: str = "Bunny"
) -> FigureSpec:
    def draw(table: Table, store: Store) -> Figure:
        target, *clouds = _clouds(table, store, labels, titles or labels)
        return densities(clouds, target)

    evenly = f"evenly the final particles fill the {target}, in a slice through its middle."
    return FigureSpec("densities", f"{before} {evenly}", draw)


_FINALS = "Final particles, coloured by their height in the sphere."
_STRIPS = FigureSpec("strips", "Trajectories.", _strips)

_PARTS = ("all of it", "places drawn at random", "without correction", "without the grid")

FIGURES: dict[str, tuple[FigureSpec, ...]] = {
    "regularisers": (
        _numbers(),
        _densities(
            ["DCO", "DCO + repulsion 0.1", "DCD", "DCD, inverse weights",
             "Density-aware (Wu et al.)", "Shared basis", "Physics"]
        ),
    ),
    "shapes": (
        _finals(
            ["{}, DCO", "{}, DCD", "{}, Physics, 3 per edge", "{}, Joint, 3 per edge"],
            ["DCO", "DCD", "physics", "joint"],
            " DCO and DCD at 4 points per edge, physics and joint at 3, as in the paper.",
        ),
        _numbers(),
    ),
    "sphere": (
        _finals(["{}, physics", "{}, joint"], ["physics", "joint"]),
        _numbers(),
        _convergence("Two-sided distance over frames.", "two_sided"),
    ),
    "scatter": (
        FigureSpec(
            "pairs",
            "Each pair: ours filled, printed hollow.",
            lambda table, _: charts.scatter(table),
        ),
    ),
    "dragon": (
        FigureSpec("finals", _FINALS, _dragons),
        _numbers(" Divided by h in the table."),
    ),
    "ablation": (_numbers(" Bars: one standard deviation over seeds."),),
    "overlap": (
        _sections("DCD, 3 per edge", "Physics, 3 per edge", "Joint, 3 per edge"),
        _STRIPS,
        _curves("Overlap over frames.", "overlap_01", "overlap_h10"),
    ),
    "convergence": (_convergence("s→t over frames, as computed.", "s2t"),),
    "teaser": (_STRIPS,),
    "fairness": (
        _curves(
            "Distance and overlap over frames at equal resolution.", "two_sided", "overlap_01"
        ),
        _sections("DCO", "DCO, converged", "Shared basis, converged", "Physics", "Joint"),
        _densities(
            ["DCO", "DCO, converged", "DCD, converged", "Density-aware (Wu et al.), converged",
             "Shared basis, converged", "Physics", "Joint", "Joint, preset fast"]
        ),
    ),
    "ingredients": (
        _densities(
            [f"Cow → Duck: {part}" for part in _PARTS],
            [part.capitalize() for part in _PARTS],
            before="Cow → Duck: how",
            target="Duck",
        ),
    ),
    "objectives": (
        _densities(
            ["Chamfer (DCO), converged", "Density-aware Chamfer, converged",
             "Sliced Wasserstein, 3600 steps", "Sinkhorn divergence, 1800 steps", "Transport"],
            ["Chamfer", "Density-aware", "Sliced Wasserstein", "Sinkhorn", "Transport"],
        ),
    ),
    "trial": (_curves("Distance over frames.", "two_sided", "s2t"), _STRIPS),
}  # fmt: skip
