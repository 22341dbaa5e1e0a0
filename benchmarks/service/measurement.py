"""What was measured, beside its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import quantiles
from typing import Literal

from benchmarks.comparison import number

HEADINGS = ("what", "measured", "limit", "unit", "verdict")


@dataclass(frozen=True)
class Measurement:
    """One line of the table.

    Attributes:
        what: What was measured.
        value: The measurement.
        limit: The most it may be, or the least; None for a figure that only informs.
        unit: Unit of both.
        note: Conditions.
        inclusive: Whether the limit itself is allowed.
        larger_is_better: Whether the limit is the least.
    """

    what: str
    value: float
    limit: float | None
    unit: str
    note: str = ""
    inclusive: bool = False
    larger_is_better: bool = False

    @property
    def verdict(self) -> Literal["within", "ABOVE", "BELOW", "info"]:
        """Where the measurement stands against the limit."""
        if self.limit is None:
            return "info"
        if self.inclusive and self.value == self.limit:
            return "within"
        if self.larger_is_better:
            return "within" if self.value > self.limit else "BELOW"
        return "within" if self.value < self.limit else "ABOVE"

    @property
    def missed(self) -> bool:
        """Whether it is on the wrong side of its limit."""
        return self.verdict in ("ABOVE", "BELOW")


def counted(what: str, count: int, allowed: int, note: str = "") -> Measurement:
    """A number of things, at most so many."""
    return Measurement(what, count, allowed, "", note, inclusive=True)


def least(what: str, value: float, limit: float, unit: str, note: str = "") -> Measurement:
    """What should be so much at least."""
    return Measurement(what, value, limit, unit, note, inclusive=True, larger_is_better=True)


def percentile(values: Sequence[float], percent: int) -> float:
    """The value that so many percent do not exceed."""
    return quantiles(values, n=100, method="inclusive")[percent - 1]


def table(figures: Sequence[Measurement]) -> str:
    """Lay the figures out for a terminal, notes below."""
    lines = [HEADINGS] + [
        (f.what, number(f.value), number(f.limit), f.unit, f.verdict) for f in figures
    ]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADINGS))]
    text = ["  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) for line in lines]
    text.insert(1, "-" * len(text[0]))
    notes = [f"{figure.what}: {figure.note}" for figure in figures if figure.note]
    return "\n".join([*(line.rstrip() for line in text), "", *notes])
