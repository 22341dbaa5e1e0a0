"""The report: one HTML file that needs nothing else, by day and by night, on a desk or a phone."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

from chamfer_morph.reproduction.report.figures import ReportFigure
from chamfer_morph.reproduction.report.section import DisplayCell, DisplayTable, Provenance, Section

TITLE = "The paper, reproduced"
PAPER = "On the Structural Failure of Chamfer Distance in 3D Shape Optimization"

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #57606a; --line: #d0d7de;
  --paper: #ffffff; --band: #f6f8fa; --accent: #0072b2; --best: #0b6b4f; --bad: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6edf3; --soft: #9aa4af; --line: #30363d;
  --paper: #0d1117; --band: #161b22; --accent: #6cb6ff; --best: #4cc38a; --bad: #ff8a80; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 1.5rem 1rem 4rem; background: var(--paper);
  color: var(--ink); font: 16px/1.55 system-ui, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .5rem 0; }
h2 { font-size: 1.25rem; margin: 3rem 0 .25rem; padding-top: 1rem;
  border-top: 1px solid var(--line); }
a { color: var(--accent); }
.soft, figcaption, summary { color: var(--soft); font-size: .9rem; }
.findings { border-left: 3px solid var(--accent); padding: .1rem 0 .1rem .9rem; margin: .8rem 0; }
.findings p { margin: .35rem 0; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .55rem; text-align: right; white-space: nowrap; }
thead th { color: var(--soft); font-weight: 600; border-bottom: 1px solid var(--line); }
thead .over { text-align: center; }
tbody th { text-align: left; font-weight: 400; position: sticky; left: 0;
  background: var(--paper); white-space: normal; min-width: 9rem; }
tbody tr:nth-child(even) > * { background: var(--band); }
.first { border-left: 1px solid var(--line); }
.best { font-weight: 700; color: var(--best); }
.failed { color: var(--bad); }
.remark { display: block; color: var(--soft); font-size: .78rem; }
figure { margin: 1.2rem 0; }
img { display: block; max-width: 100%; height: auto; background: #ffffff; border-radius: 6px;
  padding: .4rem; }
nav ol { columns: 16rem; padding-left: 1.3rem; }
details { margin: .8rem 0; }
"""


def report(sections: Sequence[Section], *, made: str) -> str:
    """The whole report.

    Args:
        sections: In order.
        made: A sentence on when and with what it was made.

    Returns:
        HTML that asks the network for nothing.
    """
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
<style>{_STYLE}</style>
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
        _grid(section.table) if section.table else "",
        *(_figure(picture) for picture in section.figures),
        f'<div class="soft">{_paragraphs(section.remarks)}</div>' if section.remarks else "",
        _provenance(section.provenance) if section.provenance else "",
        "</section>",
    ]
    return "\n".join(filter(None, parts))


def _paragraphs(sentences: Iterable[str]) -> str:
    return "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)


def _grid(grid: DisplayTable) -> str:
    firsts = _first_columns(grid)
    over = "".join(
        f'<th class="over first" colspan="{span}">{escape(name)}</th>'
        for name, span in grid.headings
    )
    columns = "".join(
        f'<th class="first">{escape(name)}</th>' if index in firsts else f"<th>{escape(name)}</th>"
        for index, name in enumerate(grid.columns)
    )
    rows = "\n".join(
        f"<tr><th>{escape(name)}{_remark(remark)}</th>"
        + "".join(_entry(entry, is_first=index in firsts) for index, entry in enumerate(entries))
        + "</tr>"
        for name, remark, entries in grid.rows
    )
    return (
        f'<div class="wide"><table><thead><tr><th></th>{over}</tr><tr><th></th>{columns}</tr>'
        f"</thead>\n<tbody>{rows}</tbody></table></div>"
    )


def _first_columns(grid: DisplayTable) -> set[int]:
    """Indices of the columns at which a heading begins."""
    firsts, place = set(), 0
    for _, span in grid.headings:
        firsts.add(place)
        place += span
    return firsts


def _remark(text: str) -> str:
    return f'<span class="remark">{escape(text)}</span>' if text else ""


def _entry(entry: DisplayCell, *, is_first: bool) -> str:
    kinds = [
        *(["first"] if is_first else []),
        *(["best"] if entry.is_best else []),
        *(["failed"] if entry.text == "failed" else []),
    ]
    attribute = f' class="{" ".join(kinds)}"' if kinds else ""
    return f"<td{attribute}>{escape(entry.text)}</td>"


def _figure(picture: ReportFigure) -> str:
    if not picture.png:
        return f'<p class="soft">{escape(picture.problem)}</p>'
    image = base64.b64encode(picture.png).decode()
    caption = escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{image}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _provenance(sources: Sequence[Provenance]) -> str:
    names = ("run", "configuration and meshes", "preset", "particles, frames", "CPU", "version")
    head = "".join(f"<th>{name}</th>" for name in names)
    rows = "\n".join(
        f"<tr><th>{escape(s.run)}</th>"
        + "".join(f"<td>{escape(x)}</td>" for x in (s.digest, s.config, s.size, s.cost, s.version))
        + "</tr>"
        for s in sources
    )
    return (
        "<details><summary>Where the numbers come from</summary>"
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
        "</div></details>"
    )
