"""The 2D experiment as a section of the report."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import date
from importlib import metadata
from pathlib import Path

from chamfer_morph.reproduction.planar.config import PlanarConfig
from chamfer_morph.reproduction.planar.experiment import PlanarRow, PlanarTable, run_all
from chamfer_morph.reproduction.planar.figure import figure, stages
from chamfer_morph.reproduction.report.figures import save
from chamfer_morph.reproduction.report.section import Section, display_table
from chamfer_morph.reproduction.report.sources import THIS_REPORT, Source
from chamfer_morph.reproduction.report.tables import VERSION, Cell, csv_text, format_exact

NAMES = {
    "cd": "two-sided",
    "coverage": "coverage",
    "cluster_02": "clustered < .02",
    "cluster_005": "clustered < .005",
    "targets_used": "targets used",
    "crowded": "crowded",
    "unevenness": "uneven",
}
"""Headings of the table by metric."""

LABELS = {
    "start": "The circle itself",
    "even_spread": "600 points spread evenly over the star",
    "dco": "DCO",
    "dco_repulsion": "DCO + repulsion",
    "dco_repulsion_vector": "DCO + repulsion, force over distance, summed",
    "dco_repulsion_tuned": "DCO + repulsion, weight tuned",
    "fourier": "Shared basis (Fourier)",
    "fourier_clipped": "Shared basis (Fourier), clipped",
}


def planar_section(name: str, title: str, origin: str, figures: Path) -> Section:
    """Run the 2D experiment and lay it out, its figure drawn into a folder.

    Raises:
        OSError: The folder cannot be written.
    """
    table = run_all()
    rows = table.values()
    return Section(
        name=name,
        title=title,
        origin=origin,
        findings=tuple(findings(table)),
        remarks=(
            "Rows of the paper's setting take 300 plain steps; converged rows the same loss with "
            "5000 steps of Adam.",
            "The paper's cluster fraction is 100% for a perfect result too: 600 points spread "
            "evenly over the star lie 0.0135 apart, closer than its 0.02.",
        ),
        table=display_table(
            [(_label(r), f"{r.steps} steps" if r.steps else "", _cells(r)) for r in rows], NAMES
        ),
        csv=_csv(rows),
        figures=(
            save(
                stages(table),
                figures / f"{name}-stages",
                "Initial, mid and final steps in the paper's setting, and the distance over them.",
            ),
            save(
                figure(table),
                figures / f"{name}-ends",
                "Where the points start and end; colour and size tell how many lie in a heap.",
            ),
        ),
        sources=tuple(_source(row, row.config) for row in rows if row.config),
    )


def findings(table: PlanarTable) -> list[str]:
    """What the numbers show, beside the paper's claims."""
    numbers = {place: row.metrics for place, row in table.items()}
    start, ideal = numbers["start", "reference"], numbers["even_spread", "reference"]
    dco, fourier = numbers["dco", "paper"], numbers["fourier", "paper"]
    dco_rest, fourier_rest = numbers["dco", "converged"], numbers["fourier", "converged"]
    tuned = numbers["dco_repulsion_tuned", "converged"]
    return [
        f"In the paper's setting DCO goes from {start.cd:.3f} to {dco.cd:.3f} (printed 0.352), "
        f"{1 - dco.cd / start.cd:.0%} less: it has hardly begun. The shared basis ends at "
        f"{fourier.cd:.3f} (printed 0.123).",
        f"Converged, DCO ends at {dco_rest.cd:.3f} with {dco_rest.coverage:.0%} covered, the "
        f"shared basis at {fourier_rest.cd:.3f} with {fourier_rest.coverage:.0%}: "
        f"{'DCO' if dco_rest.cd < fourier_rest.cd else 'the shared basis'} is closer. Points "
        f"closer than 0.005 to another: {dco_rest.cluster_005:.0%} and "
        f"{fourier_rest.cluster_005:.0%}.",
        f"A local repulsion of fitting weight ends at {tuned.cd:.3f} with {tuned.coverage:.0%} "
        f"covered and {tuned.cluster_005:.0%} closer than 0.005: local terms can undo collapse.",
        f"The paper's cluster fraction of an even spread is {ideal.cluster_02:.0%}: it cannot tell "
        "collapse from success.",
    ]


def _label(row: PlanarRow) -> str:
    label = LABELS.get(row.name, row.name)
    return label if row.setting == "reference" else f"{label}, {row.setting}"


def _cells(row: PlanarRow) -> dict[str, Cell]:
    return {
        column: Cell(getattr(row.printed, column, None), ours=getattr(row.metrics, column))
        for column in NAMES
    }


def _csv(rows: Iterable[PlanarRow]) -> str:
    version = metadata.version(VERSION)
    lines = (
        (
            _label(row),
            column,
            format_exact(cell.printed),
            format_exact(cell.ours),
            row.steps,
            _settings(row.config) if row.config else "",
            version,
        )
        for row in rows
        for column, cell in _cells(row).items()
    )
    return csv_text(("row", "metric", "printed", "ours", "steps", "config", "version"), lines)


def _settings(config: PlanarConfig) -> str:
    return config.model_dump_json(exclude_defaults=True)


def _source(row: PlanarRow, config: PlanarConfig) -> Source:
    return Source(
        run=f"{row.name}, {row.setting}",
        inputs="",
        config=_settings(config),
        size=f"{config.point_count} → {config.target_count}, {config.steps} steps",
        version=metadata.version(VERSION),
        code=THIS_REPORT,
        date=f"{date.today()}",
    )
