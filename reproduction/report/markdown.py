"""The report as Markdown, for whoever reads it where it is kept, its figures beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from chamfer_morph.reproduction.report.figures import ReportFigure
from chamfer_morph.reproduction.report.html import PAPER, TITLE
from chamfer_morph.reproduction.report.section import DisplayCell, DisplayTable, Section
from chamfer_morph.reproduction.report.sources import COLUMNS, HEADING, all_sources, summary

INTRODUCTION = (
    f"*{PAPER}*: every table and figure, with what the paper prints, what the published program "
    "gives where that is known, and what this project measured. The best of ours among comparable "
    "rows is **bold**. Lengths are in grid cells."
)


def markdown(sections: Sequence[Section], *, made: str) -> str:
    """The whole report; it refers to the figures in `figures` and the numbers in `tables`."""
    parts = [f"# {TITLE}", INTRODUCTION, made, *map(_section, sections)]
    if runs := all_sources(sections):
        parts += [f"## {HEADING}", _table(COLUMNS, runs)]
    return "\n\n".join(parts) + "\n"


def _section(section: Section) -> str:
    origin = f"{section.origin[:1].upper()}{section.origin[1:]}; `morph reproduce {section.name}`"
    if section.csv:
        origin += f"; [all digits](tables/{section.name}.csv)"
    parts = [
        f"## {section.title}",
        f"{origin}.",
        *section.findings,
        _display_table(section.table) if section.table else "",
        *map(_figure, section.figures),
        *section.remarks,
        summary(section.sources),
    ]
    return "\n\n".join(filter(None, parts))


def _display_table(table: DisplayTable) -> str:
    headings = [heading for heading, _ in table.columns]
    columns = [
        heading if kind == "ours" and headings.count(heading) == 1 else f"{heading}, {kind}"
        for heading, kind in table.columns
    ]
    rows = ((name, *map(_cell, cells)) for name, _, cells in table.rows)
    remarks = [f"- {name}: {remark}" for name, remark, _ in table.rows if remark]
    return "\n\n".join(filter(None, (_table(("", *columns), rows), "\n".join(remarks))))


def _cell(cell: DisplayCell) -> str:
    return f"**{cell.text}**" if cell.is_best else cell.text


def _figure(figure: ReportFigure) -> str:
    if not figure.png:
        return figure.problem
    return f"![{figure.caption}](figures/{figure.name}.png)"


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ["---"] + ["--:"] * (len(columns) - 1), *rows]
    return "\n".join(f"| {' | '.join(_escaped(cell) for cell in line)} |" for line in lines)


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")
