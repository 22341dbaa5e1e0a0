"""The executable propositions as a section of the report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path

from chamfer_morph.reproduction.propositions import Check, Quantity, all_checks, figure
from chamfer_morph.reproduction.report.figures import save
from chamfer_morph.reproduction.report.section import DisplayCell, DisplayTable, Section
from chamfer_morph.reproduction.report.tables import VERSION, csv_text, format_exact


def propositions_section(name: str, title: str, origin: str, figures: Path) -> Section:
    """Put the propositions to the test and lay it out, the figure drawn into a folder.

    Raises:
        OSError: The folder cannot be written.
    """
    checks = all_checks()
    return Section(
        name=name,
        title=title,
        origin=origin,
        findings=tuple(findings(checks)),
        remarks=(
            "The rows of a proposition are identities, and hold to rounding. Rows that begin with "
            "Against are counterexamples within the assumptions of a statement. Rows that begin "
            "with Beyond are cases that it does not cover, measured against what it would say, "
            "were it applied.",
        ),
        table=DisplayTable(
            columns=(("", "measured"), ("", "should be"), ("", "verdict")),
            rows=tuple(_rows(checks)),
        ),
        csv=_csv(checks),
        figures=(
            save(
                figure(),
                figures / f"{name}-limits",
                "The statements and their limits on small scenes.",
            ),
        ),
    )


def findings(checks: Sequence[Check]) -> list[str]:
    """Which propositions hold within their assumptions, and how many limits are real ones."""
    holding = [check.name for check in checks if check.holds]
    refuted = [check.name for check in checks if check.is_refuted]
    failing = [check.name for check in checks if not (check.holds or check.is_refuted)]
    limits = [limit for check in checks for limit in check.limits]
    real = sum(limit.is_counterexample for limit in limits)
    return [
        f"Within their assumptions hold: {', '.join(holding) or 'none'}."
        + (f" Refuted as written: {', '.join(refuted)}." if refuted else "")
        + (f" Not: {', '.join(failing)}." if failing else ""),
        f"{real} of {len(limits)} cases beyond the assumptions come out otherwise than the "
        "proposition would say, so the assumptions matter.",
    ]


def _rows(checks: Sequence[Check]) -> Iterator[tuple[str, str, tuple[DisplayCell, ...]]]:
    for check in checks:
        for quantity in check.quantities:
            verdict = "holds" if quantity.holds else "fails"
            yield f"{check.name}: {quantity.name}", "", _entries(quantity, verdict)
        for case in check.refuted_by:
            verdict = "refutes it" if case.is_counterexample else "does not refute it"
            cells = _entries(case.prediction, verdict)
            yield f"Against {check.name}: {case.case}", case.prediction.name, cells
        for limit in check.limits:
            verdict = "does not apply" if limit.is_counterexample else "applies nevertheless"
            cells = _entries(limit.prediction, verdict)
            yield f"Beyond {check.name}: {limit.case}", limit.prediction.name, cells


def _entries(quantity: Quantity, verdict: str) -> tuple[DisplayCell, ...]:
    relation = {"=": "", "<=": "≤ ", ">=": "≥ "}[quantity.relation]
    texts = f"{quantity.measured:.4g}", f"{relation}{quantity.expected:.4g}", verdict
    return tuple(map(DisplayCell, texts))


def _csv(checks: Sequence[Check]) -> str:
    columns = (
        "proposition", "covered", "quantity", "measured", "relation", "expected", "tolerance",
        "holds", "version",
    )  # fmt: skip
    version = metadata.version(VERSION)
    lines = (
        (
            check.name,
            covered,
            name,
            format_exact(quantity.measured),
            quantity.relation,
            format_exact(quantity.expected),
            format_exact(quantity.tolerance),
            "yes" if quantity.holds else "no",
            version,
        )
        for check in checks
        for covered, name, quantity in (
            *(("yes", each.name, each) for each in check.quantities),
            *(("yes", f"{it.case} {it.prediction.name}", it.prediction) for it in check.refuted_by),
            *(("no", f"{it.case} {it.prediction.name}", it.prediction) for it in check.limits),
        )
    )
    return csv_text(columns, lines)
