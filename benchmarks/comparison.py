"""The rows of the benchmark table: a number of ours, a peer's, and what is asked of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

Verdict = Literal["aim", "pass", "BELOW", "info", "skipped", "FAILED"]


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: What is compared.
        ours: Our measurement.
        peer: The peer's, in the same unit; None where the bar is on our number itself.
        unit: Unit of `ours` and `peer`.
        score: The number the bar is about: a ratio where there is a peer, else `ours`.
        at_least, aim: The bar; None for a row that only informs.
        larger_is_better: Direction of the bar.
        note: Conditions, or why there is no measurement.
        failure: Whether the measurement broke, rather than being impossible here.
    """

    what: str
    ours: float
    peer: float | None
    unit: str
    score: float
    at_least: float | None = None
    aim: float | None = None
    larger_is_better: bool = True
    note: str = ""
    failure: bool = False

    @property
    def verdict(self) -> Verdict:
        """Where the score stands against the bar."""
        if self.failure:
            return "FAILED"
        if math.isnan(self.score):
            return "skipped"
        if self.at_least is None or self.aim is None:
            return "info"
        if self._reaches(self.aim):
            return "aim"
        return "pass" if self._reaches(self.at_least) else "BELOW"

    def _reaches(self, bar: float) -> bool:
        return self.score >= bar if self.larger_is_better else self.score <= bar

    def document(self) -> dict[str, Any]:
        """The row as JSON fields; a row without a measurement has null numbers."""
        fields = asdict(self) | {"verdict": self.verdict}
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in fields.items()
        }


def speedup(
    what: str,
    ours: float,
    peer: float,
    unit: str,
    at_least: float | None = None,
    aim: float | None = None,
    note: str = "",
) -> Row:
    """How many times less ours costs than the peer."""
    return Row(what, ours, peer, unit, peer / ours, at_least, aim, note=note)


def limit(
    what: str,
    ours: float,
    unit: str,
    at_least: float | None = None,
    aim: float | None = None,
    note: str = "",
    relative_to: float | None = None,
) -> Row:
    """A cost that should stay below the bar, absolute or relative to another cost of ours."""
    score = ours if relative_to is None else ours / relative_to
    return Row(what, ours, relative_to, unit, score, at_least, aim, False, note)


def skipped(what: str, reason: str) -> Row:
    """A row that could not be measured here."""
    return Row(what, math.nan, None, "", math.nan, note=reason)


def failed(what: str, reason: str) -> Row:
    """A group of rows whose measurement broke, a peer's disagreement included."""
    return replace(skipped(what, reason), failure=True)


HEADINGS = ("what", "ours", "peer", "unit", "score", "at least", "aim", "verdict")


def table(rows: Sequence[Row]) -> str:
    """Lay the rows out for a terminal, notes below."""
    cells = [HEADINGS] + [
        (
            row.what,
            number(row.ours),
            number(row.peer),
            row.unit,
            number(row.score),
            number(row.at_least),
            number(row.aim),
            row.verdict,
        )
        for row in rows
    ]
    widths = [max(len(line[i]) for line in cells) for i in range(len(HEADINGS))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) for line in cells]
    lines.insert(1, "-" * len(lines[0]))
    notes = [f"{row.what}: {row.note}" for row in rows if row.note]
    return "\n".join([*(line.rstrip() for line in lines), "", *notes])


def number(value: float | None) -> str:
    """Three significant digits, or a dash."""
    if value is None or math.isnan(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
