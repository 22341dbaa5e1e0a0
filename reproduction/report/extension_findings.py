"""What the tables past the paper show, in sentences made of their own numbers."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from statistics import median

from chamfer_morph.reproduction.report.paired import median_interval
from chamfer_morph.reproduction.report.tables import (
    METRIC_NAMES,
    Table,
    distance_from_ideal,
)

Bound = tuple[str, str, str, float, float]

BOUNDS: tuple[Bound, ...] = (
    ("iou", "volume overlap", "a volume overlap below .95", 0.95, inf),
    ("rho_p05", "5 % quantile of the density", "a 5 % quantile of the density below .70", 0.7, inf),
    ("rho_p95", "95 % quantile", "a 95 % quantile above 1.45", 0, 1.45),
    ("rho_p99", "99 % quantile", "a 99 % quantile above 2", 0, 2),
    ("hausdorff", "Hausdorff distance", "a Hausdorff distance above .9", 0, 0.9),
    (
        "surface_mean",
        "distance of the surfaces",
        "a surface farther than .20 from the target's",
        0,
        0.2,
    ),
    (
        "overlap_h10",
        "share of particles closer than .1 h to another",
        "particles closer than .1 h to another",
        0,
        0,
    ),
)
"""What a full and even morph keeps to: a metric, its name, what is beyond, least and greatest."""


def transport(table: Table) -> list[str]:
    """Transport against joint, pair by pair, and against the bounds of a full, even morph."""
    sentences = []
    distances = table.pairs(table.groups, "{}, transport", "{}, joint", "two_sided")
    if distances:
        ratios = {pair: ours / joint for pair, (ours, joint) in distances.items()}
        worst = max(ratios, key=lambda pair: ratios[pair])
        sentences.append(
            f"Two-sided distance in parts of joint's: median {median(ratios.values()):.2f}, "
            f"at most {ratios[worst]:.2f} ({worst}), over {len(ratios)} pairs."
        )
    for metric, words in (("f1", "F1"), ("iou", "Volume overlap")):
        numbers = table.pairs(table.groups, "{}, transport", "{}, joint", metric)
        if numbers:
            gains = {pair: ours - joint for pair, (ours, joint) in numbers.items()}
            worst = min(gains, key=lambda pair: gains[pair])
            sentences.append(f"{words} is {gains[worst]:+.3f} of joint's at the least ({worst}).")
    labels = [line.row.label for line in table.lines if line.row.label.endswith(", transport")]
    return [*sentences, *_cost(table), *bounds(table, labels)]


def headline(table: Table) -> list[str]:
    """Each method's median of each number, and how far a second draw of the points moves any.

    Medians over the pairs have an interval of 95 %.

    Methods that have not been run on all pairs have none: their pairs may be the easy ones.
    """
    methods: dict[str, list[str]] = {}
    for line in table.lines:
        methods.setdefault(line.row.label.rpartition(", ")[2], []).append(line.row.label)
    sentences = []
    for metric in table.experiment.metrics:
        numbers = {method: table.numbers(metric, labels) for method, labels in methods.items()}
        parts = [
            f"{method} {_median(list(values.values()))}"
            for method, values in numbers.items()
            if len(values) == len(methods[method])
        ]
        if parts:
            sentences.append(f"{METRIC_NAMES[metric]}, medians: {', '.join(parts)}.")
    return [*sentences, *_largest_move(table)]


def _median(values: list[float]) -> str:
    low, high = median_interval(values)
    return f"{median(values):.3f} ({low:.3f} to {high:.3f})"


def _largest_move(table: Table) -> list[str]:
    """How far any number moves when the points are drawn again."""
    moves = {
        (line.row.label, metric): abs(first - second) / max(abs(first), abs(second))
        for line in table.lines
        for record in line.records
        if len(record.ends) > 1
        for metric in table.experiment.metrics
        if (first := record.ends[0][metric]) != (second := record.ends[1][metric])
    }
    if not moves:
        return []
    label, metric = max(moves, key=lambda each: moves[each])
    return [
        f"With all points drawn again no number moves by more than {moves[label, metric]:.1%} "
        f"({METRIC_NAMES[metric]} of {label})."
    ]


def _cost(table: Table) -> list[str]:
    """CPU time of a run of either method."""
    seconds: dict[str, list[float]] = {}
    for line in table.lines:
        method = line.row.label.rpartition(", ")[2]
        costs = [record.provenance.cpu_seconds for record in line.records if record.is_complete]
        seconds.setdefault(method, []).extend(costs)
    parts = [
        f"{method} {median(costs):.0f} s (at most {max(costs):.0f})"
        for method, costs in seconds.items()
        if costs
    ]
    return [f"CPU time of a run, median: {'; '.join(parts)}."] if parts else []


def bounds(table: Table, labels: Sequence[str] | None = None) -> list[str]:
    """The worst of each bounded metric, its median, and which rows are beyond a bound."""
    extremes, beyond = [], []
    for metric, name, words, least, greatest in BOUNDS:
        values = table.numbers(metric, labels)
        if values:
            worst = max(values, key=lambda label: distance_from_ideal(metric, values[label]))
            middle = median(values.values())
            extremes.append(f"{name} {values[worst]:.3f} ({worst}), median {middle:.3f}")
        rows = [
            f"{label} ({value:.3f})"
            for label, value in values.items()
            if value < least or value > greatest
        ]
        if rows:
            beyond.append(f"{words}: {', '.join(rows)}")
    count = len(table.numbers("iou", labels))
    sentences = [f"The worst of {count} rows: {'; '.join(extremes)}."] if extremes else []
    if table.numbers("iou", labels):
        end = (
            f"There is {'; '.join(beyond)}."
            if beyond
            else f"None of these {count} rows is beyond these bounds."
        )
        sentences.append(end)
    return sentences


def motion(table: Table) -> list[str]:
    """The extremes of all trajectories together."""
    extremes = []
    for metric, words, worst in (
        ("least_gap_ever", "the closest two particles are {:.2f} h apart", min),
        ("det_f_min_ever", "det F stays above {:.2f}", min),
        ("det_f_max_ever", "and below {:.2f}", max),
        ("max_move_ever", "the farthest move in a frame is {:.2f} dx", max),
    ):
        values = table.numbers(metric)
        if values:
            extremes.append(words.format(worst(values.values())))
    return [f"Over all pairs and frames {', '.join(extremes)}."] if extremes else []


def ingredients(table: Table) -> list[str]:
    """What leaving out a part changes, as the median over pairs."""
    changes: dict[str, list[float]] = {}
    distances = table.numbers("two_sided")
    for row, distance in distances.items():
        pair, _, label = row.partition(": ")
        whole = distances.get(f"{pair}: all of it")
        if whole and label != "all of it":
            changes.setdefault(label, []).append(distance / whole)
    if not changes:
        return []
    parts = [f"{label} {median(values):.2f}" for label, values in changes.items()]
    return [f"Two-sided distance in parts of the whole method's, medians: {'; '.join(parts)}."]


def objectives(table: Table) -> list[str]:
    """Who collapses."""
    shares = [f"{label} {share:.1%}" for label, share in table.numbers("overlap_h10").items()]
    return [f"Particles closer than .1 h to another: {'; '.join(shares)}."] if shares else []
