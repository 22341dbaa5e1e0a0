"""The report as Markdown, for whoever reads it where it is kept, its figures beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from chamfer_morph.reproduction.report.figures import ReportFigure
from chamfer_morph.reproduction.report.html import PAPER, TITLE
from chamfer_morph.reproduction.report.section import DisplayCell, DisplayTable, Provenance, Section

INTRODUCTION = (
    f"*{PAPER}*: every table and figure, with what the paper prints, what the published program "
    "gives where that is known, and what this project measured. The best of ours among comparable "
    "rows is **bold**. Lengths are in grid cells."
)


def markdown(sections: Sequence[Section], *, made: str) -> str:
    """The whole report.

    Args:
        sections: In order.
        made: A sentence on when and with what it was made.

    Returns:
        Markdown that refers to the figures in `figures` and the numbers in `tables`.
    """
    parts = [f"# {TITLE}", INTRODUCTION, made, *map(_section, sections)]
    return "\n\n".join(parts) + "\n"


def _section(section: Section) -> str:
    origin = f"{section.origin[:1].upper()}{section.origin[1:]}; `morph reproduce {section.name}`"
    if section.csv:
        origin += f"; [all digits](tables/{section.name}.csv)"
    parts = [
        f"## {section.title}",
        f"{origin}.",
        *section.findings,
        _grid(section.table) if section.table else "",
        *map(_picture, section.figures),
        *section.remarks,
        _sources(section.provenance) if section.provenance else "",
    ]
    return "\n\n".join(filter(None, parts))


def _grid(grid: DisplayTable) -> str:
    over = [name for name, span in grid.headings for _ in range(span)]
    columns = [
        heading if kind == "ours" and over.count(heading) == 1 else f"{heading}, {kind}"
        for heading, kind in zip(over, grid.columns, strict=True)
    ]
    rows = ((name, *map(_entry, entries)) for name, _, entries in grid.rows)
    remarks = [f"- {name}: {remark}" for name, remark, _ in grid.rows if remark]
    return "\n\n".join(filter(None, (_table(("", *columns), rows), "\n".join(remarks))))


def _entry(entry: DisplayCell) -> str:
    return f"**{entry.text}**" if entry.is_best else entry.text


def _picture(picture: ReportFigure) -> str:
    if not picture.png:
        return picture.problem
    return f"![{picture.caption}](figures/{picture.name}.png)"


def _sources(sources: Sequence[Provenance]) -> str:
    columns = ("run", "configuration and meshes", "preset", "particles, frames", "CPU", "version")
    rows = ((s.run, s.digest, s.config, s.size, s.cost, s.version) for s in sources)
    return "\n\n".join(
        (
            "<details><summary>Where the numbers come from</summary>",
            _table(columns, rows),
            "</details>",
        )
    )


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ["---"] + ["--:"] * (len(columns) - 1), *rows]
    return "\n".join(f"| {' | '.join(_escaped(cell) for cell in line)} |" for line in lines)


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")
