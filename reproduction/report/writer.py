"""What a reproduction leaves behind: a CSV file per table, figures, and the report, twice."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib import metadata
from pathlib import Path

from chamfer_morph.reproduction.experiments.experiment import Experiment
from chamfer_morph.reproduction.registry import AnyExperiment
from chamfer_morph.reproduction.report.html import report
from chamfer_morph.reproduction.report.markdown import markdown
from chamfer_morph.reproduction.report.section import Section, section_of
from chamfer_morph.reproduction.report.tables import tabulate
from chamfer_morph.reproduction.runs.store import Record, Store
from morph_engine.errors import ResultError
from morph_engine.files import replacing
from morph_engine.results.provenance import commit


@dataclass(frozen=True)
class Output:
    """What was written.

    Attributes:
        sections: The contents.
        report: The HTML file.
    """

    sections: tuple[Section, ...]
    report: Path


def write(
    experiments: Sequence[AnyExperiment], records: Mapping[str, Record], store: Store
) -> Output:
    """Write tables, figures and the report into the folder of a store; records are by run id.

    Raises:
        ResultError: The disk refuses.
    """
    folder = store.folder
    figures = folder / "figures"
    try:
        figures.mkdir(parents=True, exist_ok=True)
        sections = tuple(
            section_of(tabulate(experiment, records), store, figures)
            if isinstance(experiment, Experiment)
            else experiment.section(figures)
            for experiment in experiments
        )
        for section in sections:
            if section.csv:
                _write(folder / "tables" / f"{section.name}.csv", section.csv)
        path = folder / "report.html"
        _write(path, report(sections, made=_made()))
        _write(folder / "report.md", markdown(sections, made=_made()))
    except OSError as error:
        raise ResultError(
            f"Cannot write to {folder} ({error.strerror or error}).",
            "Free some disk space, or select another folder with --results.",
        ) from error
    return Output(sections, path)


def _made() -> str:
    version = metadata.version("chamfer-morph")
    made_from = f" (commit {commit()})" if commit() else ""
    return (
        f"Made on {datetime.now():%Y-%m-%d} with chamfer-morph {version}{made_from}, "
        f"Python {platform.python_version()}, {platform.machine()}."
    )


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
