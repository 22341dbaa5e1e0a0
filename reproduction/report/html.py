"""The report: one HTML file that needs nothing else, by day and by night, on a desk or a phone."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from pathlib import Path

from chamfer_morph.reproduction.report.figures import ReportFigure
from chamfer_morph.reproduction.report.section import DisplayCell, DisplayTable, Section
from chamfer_morph.reproduction.report.sources import COLUMNS, HEADING, all_sources, summary

TITLE = "The paper, reproduced"
PAPER = "On the Structural Failure of Chamfer Distance in 3D Shape Optimization"

_STYLE = Path(__file__).with_name("report.css").read_text(encoding="utf-8")


def report(sections: Sequence[Section], *, made: str) -> str:
    """The whole report; a sentence says when and with what it was made."""
    body = "\n".join(_section(section) for section in sections)
    entries = "\n".join(
        f'<li><a href="#{escape(s.name)}">{escape(s.title)}</a> '
        f'<span class="soft">{escape(s.origin)}</span></li>'
        for s in sections
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{TITLE}</title>
<style>
{_STYLE}</style>
</head>
<body>
<h1>{TITLE}</h1>
<p class="soft">{PAPER}. {escape(made)}</p>
<p>Each number stands beside the one printed in the paper and, where it is known, beside that of
the published program. Difference is ours minus printed. The best of ours in a group of comparable
rows is <span class="best">marked</span>. Lengths are in grid cells.</p>
<nav><ol>
{entries}
</ol></nav>
{body}
{_sources(sections)}
</body>
</html>
"""


def _section(section: Section) -> str:
    origin = f"{section.origin} · morph reproduce {section.name}"
    parts = [
        f'<section id="{escape(section.name)}">',
        f"<h2>{escape(section.title)}</h2>",
        f'<div class="soft">{escape(origin)}</div>',
        f'<div class="findings">{_paragraphs(section.findings)}</div>' if section.findings else "",
        _table(section.table) if section.table else "",
        *(_figure(figure) for figure in section.figures),
        f'<div class="soft">{_paragraphs(section.remarks)}</div>' if section.remarks else "",
        f'<p class="soft">{escape(summary(section.sources))}</p>' if section.sources else "",
        "</section>",
    ]
    return "\n".join(filter(None, parts))


def _paragraphs(sentences: Iterable[str]) -> str:
    return "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)


def _table(table: DisplayTable) -> str:
    over = ""
    is_first: list[bool] = []
    for heading, group in groupby(heading for heading, _ in table.columns):
        span = len(list(group))
        over += f'<th class="over first" colspan="{span}">{escape(heading)}</th>'
        is_first += [True] + [False] * (span - 1)
    columns = "".join(
        f'<th class="first">{escape(name)}</th>' if first else f"<th>{escape(name)}</th>"
        for first, (_, name) in zip(is_first, table.columns, strict=True)
    )
    rows = "\n".join(
        f"<tr><th>{escape(name)}{_remark(remark)}</th>{''.join(map(_cell, cells, is_first))}</tr>"
        for name, remark, cells in table.rows
    )
    return (
        f'<div class="wide"><table><thead><tr><th></th>{over}</tr><tr><th></th>{columns}</tr>'
        f"</thead>\n<tbody>{rows}</tbody></table></div>"
    )


def _remark(text: str) -> str:
    return f'<span class="remark">{escape(text)}</span>' if text else ""


def _cell(cell: DisplayCell, is_first: bool) -> str:
    marks = (("first", is_first), ("best", cell.is_best), ("failed", cell.text == "failed"))
    kinds = " ".join(name for name, applies in marks if applies)
    attribute = f' class="{kinds}"' if kinds else ""
    return f"<td{attribute}>{escape(cell.text)}</td>"


def _figure(figure: ReportFigure) -> str:
    if not figure.png:
        return f'<p class="soft">{escape(figure.problem)}</p>'
    image = base64.b64encode(figure.png).decode()
    caption = escape(figure.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{image}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _sources(sections: Iterable[Section]) -> str:
    """The list of all runs."""
    runs = all_sources(sections)
    if not runs:
        return ""
    head = "".join(f"<th>{name}</th>" for name in COLUMNS)
    rows = "\n".join(
        f"<tr><th>{escape(run)}</th>" + "".join(f"<td>{escape(x)}</td>" for x in rest) + "</tr>"
        for run, *rest in runs
    )
    return (
        f'<section id="sources"><h2>{HEADING}</h2>'
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
        "</div></section>"
    )
