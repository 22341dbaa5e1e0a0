"""Differences of rows that share their seeds, counts and medians over pairs, with intervals."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binom, norm, t

from chamfer_morph.reproduction.report.tables import Table

LEVEL = 0.95
"""Of every interval."""


@dataclass(frozen=True)
class PairedDifference:
    """The mean of differences between runs of equal seed, in the unit of their metric.

    Attributes:
        mean: First minus second.
        half_width: Half the width of Student's interval around it.
        count: Seeds.
    """

    mean: float
    half_width: float
    count: int

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval lies on one side of zero."""
        return abs(self.mean) > self.half_width

    def __str__(self) -> str:
        low, high = self.mean - self.half_width, self.mean + self.half_width
        return f"{self.mean:+.4f} ({low:+.4f} to {high:+.4f})"


def paired_difference(
    table: Table, first: str, second: str, metric: str
) -> PairedDifference | None:
    """The difference of two rows over the seeds that both have; None with fewer than two."""
    by_seed: list[dict[int, float]] = []
    for label in (first, second):
        records = next((line.records for line in table.lines if line.row.label == label), ())
        by_seed.append(
            {each.run.seed: each.metrics[metric] for each in records if metric in each.metrics}
        )
    seeds = by_seed[0].keys() & by_seed[1].keys()
    if len(seeds) < 2:
        return None
    differences = [by_seed[0][seed] - by_seed[1][seed] for seed in seeds]
    count = len(differences)
    quantile = float(t.ppf((1 + LEVEL) / 2, count - 1))
    half_width = quantile * statistics.stdev(differences) / math.sqrt(count)
    return PairedDifference(statistics.fmean(differences), half_width, count)


def share_interval(successes: int, count: int) -> tuple[float, float]:
    """Wilson's score interval of a share, 0 to 1: what a count of wins over pairs can tell.

    It takes the pairs as independent, which those of five shapes are not quite.
    """
    z = float(norm.ppf((1 + LEVEL) / 2))
    share = successes / count
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * math.sqrt(share * (1 - share) / count + (z / count / 2) ** 2)
    return max(0.0, middle - half), min(1.0, middle + half)


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """An interval for the median over pairs, between two of the values, whatever they follow.

    With fewer than six values it would have to be wider than they are: it is all of them.
    """
    ordered = sorted(values)
    below = max(int(binom.ppf((1 - LEVEL) / 2, len(ordered), 0.5)) - 1, 0)
    return ordered[below], ordered[-1 - below]
