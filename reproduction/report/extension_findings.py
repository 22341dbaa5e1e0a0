"""What the tables past the paper show, in sentences made of their own numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median

from chamfer_morph.reproduction.report.tables import Table, distance_from_ideal

Bound = tuple[str, str, Callable[[float], bool]]

BOUNDS: tuple[Bound, ...] = (
    ("iou", "a volume overlap below .95", lambda value: value < 0.95),
    ("rho_p05", "a 5 % quantile of the density below .70", lambda value: value < 0.70),
    ("rho_p95", "a 95 % quantile above 1.45", lambda value: value > 1.45),
    ("rho_p99", "a 99 % quantile above 2", lambda value: value > 2.0),
    ("hausdorff", "a Hausdorff distance above .9", lambda value: value > 0.9),
    ("surface_mean", "a surface farther than .20 from the target's", lambda value: value > 0.2),
    ("overlap_h10", "particles closer than .1 h to another", lambda value: value > 0),
)
"""What a full and even morph keeps to."""

NAMES = {
    "iou": "volume overlap",
    "rho_p05": "5 % quantile of the density",
    "rho_p95": "95 % quantile",
    "rho_p99": "99 % quantile",
    "hausdorff": "Hausdorff distance",
    "surface_mean": "distance of the surfaces",
    "overlap_h10": "share of particles closer than .1 h to another",
}


def transport(table: Table) -> list[str]:
    """Transport against joint, pair by pair, and against the bounds of a full, even morph."""
    sentences = []
    distances = _beside_joint(table, "two_sided")
    if distances:
        ratios = {pair: ours / joint for pair, (ours, joint) in distances.items()}
        worst = max(ratios, key=lambda pair: ratios[pair])
        sentences.append(
            f"Two-sided distance in parts of joint's: median {median(ratios.values()):.2f}, "
            f"at most {ratios[worst]:.2f} ({worst}), over {len(ratios)} pairs."
        )
    for metric, words in (("f1", "F1"), ("iou", "Volume overlap")):
        numbers = _beside_joint(table, metric)
        if numbers:
            gains = {pair: ours - joint for pair, (ours, joint) in numbers.items()}
            worst = min(gains, key=lambda pair: gains[pair])
            sentences.append(f"{words} is {gains[worst]:+.3f} of joint's at the least ({worst}).")
    labels = [line.row.label for line in table.lines if line.row.label.endswith(", transport")]
    return [*sentences, *_cost(table), *_extremes(table, labels), *_within(table, labels)]


def _cost(table: Table) -> list[str]:
    """CPU time of a run of either method."""
    seconds: dict[str, list[float]] = {}
    for line in table.lines:
        method = line.row.label.rpartition(", ")[2]
        costs = [record.cpu_seconds for record in line.records if record.is_complete]
        seconds.setdefault(method, []).extend(costs)
    parts = [
        f"{method} {median(costs):.0f} s (at most {max(costs):.0f})"
        for method, costs in seconds.items()
        if costs
    ]
    return [f"CPU time of a run, median: {'; '.join(parts)}."] if parts else []


def _beside_joint(table: Table, metric: str) -> dict[str, tuple[float, float]]:
    """A metric of transport and of joint, by pair, where both are known."""
    return table.pairs(table.groups, "{}, transport", "{}, joint", metric)


def bounds(table: Table) -> list[str]:
    """Every row against the bounds of a full, even morph."""
    labels = [line.row.label for line in table.lines]
    return [*_extremes(table, labels), *_within(table, labels)]


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


def _extremes(table: Table, labels: Sequence[str]) -> list[str]:
    """The worst row of each bounded metric, and the median."""
    parts = []
    for metric, *_ in BOUNDS:
        values = table.numbers(metric, labels)
        if values:
            worst = max(values, key=lambda label: distance_from_ideal(metric, values[label]))
            parts.append(
                f"{NAMES[metric]} {values[worst]:.3f} ({worst}), median "
                f"{median(values.values()):.3f}"
            )
    return [f"The worst of {len(labels)} rows: {'; '.join(parts)}."] if parts else []


def _within(table: Table, labels: Sequence[str]) -> list[str]:
    """Which rows are beyond a bound, or that none is."""
    beyond = []
    for metric, words, is_beyond in BOUNDS:
        rows = [
            f"{label} ({value:.3f})"
            for label, value in table.numbers(metric, labels).items()
            if is_beyond(value)
        ]
        if rows:
            beyond.append(f"{words}: {', '.join(rows)}")
    if not table.numbers("iou", labels):
        return []
    return ["There is " + "; ".join(beyond) + "."] if beyond else ["No row is beyond any bound."]
