"""Where the numbers of a report come from: runs, by which code, on which machine and when."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from chamfer_morph.reproduction.report.tables import VERSION
from chamfer_morph.reproduction.runs.store import Record
from morph_engine.results.provenance import Provenance

if TYPE_CHECKING:
    from chamfer_morph.reproduction.report.section import Section

HEADING = "Where the numbers come from"

BEFORE_PROVENANCE = "before provenance"
"""Stands for the code of runs whose records do not name it."""

THIS_REPORT = "of this report"
"""Stands for the code of what is computed whenever a report is made."""

DIGITS = 12
"""Digits of a digest or commit that are shown."""


class Source(NamedTuple):
    """Where some numbers come from, a text for each of `COLUMNS` but the last."""

    run: str
    inputs: str
    config: str
    size: str
    cost: str = ""
    version: str = ""
    code: str = ""
    commit: str = ""
    machine: str = ""
    date: str = ""


COLUMNS = (
    "run", "configuration and meshes", "preset", "particles, frames", "CPU time, wall time",
    "version", "code", "commit", "computed on", "date", "tables",
)  # fmt: skip


def sources(records: Iterable[Record]) -> tuple[Source, ...]:
    """The sources of records, each run once."""
    return tuple({record.run.id: _source(record) for record in records}.values())


def all_sources(sections: Iterable[Section]) -> list[tuple[str, ...]]:
    """A row for each run of a report: its source, and the tables that it serves."""
    tables: dict[Source, list[str]] = {}
    for section in sections:
        for source in section.sources:
            tables.setdefault(source, []).append(section.name)
    return [(*source, ", ".join(names)) for source, names in tables.items()]


def summary(runs: Sequence[Source]) -> str:
    """What runs have in common, in one line: versions, code and dates; empty without runs."""
    old = [run for run in runs if run.code == BEFORE_PROVENANCE]
    noted = [run for run in runs if run.code != BEFORE_PROVENANCE]
    parts = []
    if noted:
        dates = sorted({run.date for run in noted})
        span = " to ".join(dict.fromkeys((dates[0], dates[-1])))
        code = _listed(run.code for run in noted)
        parts.append(f"{_count(noted)} by version {_versions(noted)}, code {code}, {span}")
    if old:
        parts.append(f"{_count(old)} by version {_versions(old)}, {BEFORE_PROVENANCE}")
    return f"{'; '.join(parts)}." if parts else ""


def _count(runs: Sequence[Source]) -> str:
    return f"{len(runs)} run{'s' if len(runs) > 1 else ''}"


def _versions(runs: Sequence[Source]) -> str:
    return _listed(run.version for run in runs)


def _listed(words: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(words))


def _source(record: Record) -> Source:
    provenance = record.provenance
    cost = f"{provenance.cpu_seconds:.0f} s"
    if provenance.wall_seconds:
        cost += f", {provenance.wall_seconds:.0f} s"
    return Source(
        run=record.run.id,
        inputs=record.digest[:DIGITS],
        config=f"{(record.config or record.run).preset}, seed {record.run.seed}",
        size=f"{record.particle_count} → {record.target_count}, {record.frames} frames"
        if record.is_complete
        else "failed",
        cost=cost,
        version=record.software.get(VERSION, ""),
        code=provenance.code[:DIGITS] or BEFORE_PROVENANCE,
        commit=_short(provenance.commit),
        machine=_machine(provenance),
        date=f"{provenance.date:%Y-%m-%d}" if provenance.date else "",
    )


def _short(commit: str) -> str:
    name, dash, state = commit.partition("-")
    return f"{name[:DIGITS]}{dash}{state}"


def _machine(provenance: Provenance) -> str:
    if not provenance.device:
        return ""
    threads = f"{provenance.threads} thread{'s' if provenance.threads > 1 else ''}"
    return f"{provenance.device}: {provenance.gpu or provenance.cpu}, {threads}"
