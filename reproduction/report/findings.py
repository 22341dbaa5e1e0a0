"""What a table shows, in a sentence or two made of its own numbers, beside the paper's claim."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean

from chamfer_morph.reproduction.published.numbers import CLAIMS, TARGETS
from chamfer_morph.reproduction.report import default_findings, extension_findings
from chamfer_morph.reproduction.report.paired import (
    PairedDifference,
    paired_difference,
    share_interval,
)
from chamfer_morph.reproduction.report.tables import FLOOR, Cell, Table, distance_from_ideal
from chamfer_morph.reproduction.runs.store import Record

Finding = Callable[[Table], list[str]]

NAMED_ROWS = 20
"""Rows without numbers that are named; of more their number is told."""


@dataclass
class WinCount:
    """What was compared where the first of two rows is better, and where it is not."""

    better: list[str] = field(default_factory=list)
    worse: list[str] = field(default_factory=list)

    @property
    def count(self) -> int:
        """How many were compared."""
        return len(self.better) + len(self.worse)

    @property
    def interval(self) -> str:
        """The share of the better ones, as Wilson's interval."""
        low, high = share_interval(len(self.better), self.count)
        return f"{low:.0%} to {high:.0%}"

    def __str__(self) -> str:
        return f"{len(self.better)} of {self.count}"


def compare(
    table: Table, names: Iterable[str], first: str, second: str, metric: str = "two_sided"
) -> WinCount:
    """Count where one row is better than another; comparisons without both numbers are left out.

    Labels have {} for the name.
    """
    score = WinCount()
    for name, (a, b) in table.pairs(names, first, second, metric).items():
        wins = distance_from_ideal(metric, a) < distance_from_ideal(metric, b)
        (score.better if wins else score.worse).append(name)
    return score


def findings(table: Table) -> list[str]:
    """What the numbers of a table show; says so if some are missing."""
    sentences = FINDINGS[table.experiment.name](table)
    missing = [line.row.label for line in table.lines if line.problem]
    if missing:
        named = len(missing) <= NAMED_ROWS
        what = ", ".join(missing) if named else f"{len(missing)} of {len(table.lines)} rows"
        sentences = [*sentences, f"Without {what}."]
    return sentences


def _regularisers(table: Table) -> list[str]:
    plain = table.ours("DCO", "two_sided")
    regularised = [line.row.label for line in table.lines if line.row.label.startswith("DCO + ")]
    score = compare(table, regularised, "DCO", "{}")
    sentences = [
        f"Local regularisers raise the two-sided distance in {score} variants "
        f"(the paper: {CLAIMS['regularisers_worse']} of 4)."
    ]
    physics = table.ours("Physics", "two_sided")
    if plain and physics:
        sentences.append(
            f"At the same 4 points per edge physics ends at {physics:.3f} and DCO, stopped after "
            f"1200 steps, at {plain:.3f} (the paper: 0.217 and 0.286)."
        )
    overlaps = [
        share for label, share in table.numbers("overlap_01").items() if label.startswith("DC")
    ]
    if overlaps:
        sentences.append(
            f"At most {max(overlaps):.1%} of the particles of any DCO or DCD run overlap: the "
            "tabulated runs have not collapsed."
            if max(overlaps) < 0.01
            else f"Up to {max(overlaps):.1%} of the particles of a DCO or DCD run overlap."
        )
    return sentences


def _shapes(table: Table) -> list[str]:
    fine = compare(table, TARGETS, "{}, Physics", "{}, DCO")
    usual = compare(table, TARGETS, "{}, Physics, 3 per edge", "{}, DCO, 3 per edge")
    dcd = compare(table, TARGETS, "{}, DCD", "{}, DCO")
    return [
        f"DCO ends above physics on {fine} targets at 4 points per edge (the paper: "
        f"{CLAIMS['shapes_dco_worse']} of 4) and on {usual} at 3 points per edge.",
        f"DCD ends below DCO on {dcd} (the paper: 4 of 4).",
    ]


def _sphere(table: Table) -> list[str]:
    sentences = [
        "Joint is better than physics in "
        + ", ".join(
            f"{name} on {compare(table, TARGETS, '{}, joint', '{}, physics', metric)}"
            for metric, name in (
                ("two_sided", "two-sided distance"),
                ("s2t", "s→t"),
                ("t2s", "t→s"),
                ("hausdorff", "Hausdorff"),
                ("f1", "F1"),
            )
        )
        + " targets (the paper: 4, 4, 3, 4, 4 of 4)."
    ]
    pairs = table.pairs(TARGETS, "{}, joint", "{}, physics", "s2t")
    if pairs:
        mean = fmean(joint / physics - 1 for joint, physics in pairs.values())
        sentences.append(
            f"s→t changes by {mean:+.1%} on average "
            f"(the paper: {CLAIMS['sphere_mean_s2t_change']:+.1%})."
        )
    return sentences


def _pairs(table: Table) -> list[str]:
    """Counts over the pairs, and how much of physics' matter lies on top of other matter."""
    pairs = table.groups
    two_sided = compare(table, pairs, "{}, joint", "{}, physics")
    s2t = compare(table, pairs, "{}, joint", "{}, physics", "s2t")
    dco = compare(table, pairs, "{}, physics", "{}, dco")
    sentences = [
        f"Two-sided better than physics on {two_sided} pairs; the paper: "
        f"{CLAIMS['pairs_two_sided']}. s→t better on {s2t}; the paper: {CLAIMS['pairs_s2t']}."
    ]
    if two_sided.worse:
        sentences.append(
            f"Two-sided is not better on {', '.join(two_sided.worse)} (the paper: "
            "Duck → Sphere, Cow → Sphere, Duck → Cow, Teapot → Cow)."
        )
    others = (("t2s", "t→s"), ("hausdorff", "Hausdorff"), ("f1", "F1"), ("iou", "IoU"))
    scores = {
        name: compare(table, pairs, "{}, joint", "{}, physics", metric) for metric, name in others
    }
    sentences.append(
        "Joint is better than physics in "
        + ", ".join(f"{name} on {score}" for name, score in scores.items())
        + f" pairs. Its Hausdorff distance is larger on {_listed(scores['Hausdorff'].worse)}."
    )
    if dco.better or dco.worse:
        sentences.append(
            f"DCO at the same resolution, stopped after 1200 steps with epsilon 1e-4, ends above "
            f"physics on {dco} pairs (the paper: on the majority, without numbers)."
        )
    named = {"two-sided": two_sided, "s→t": s2t, **scores, "DCO above physics": dco}
    intervals = [f"{name} {score.interval}" for name, score in named.items() if score.count]
    if intervals:
        sentences.append(
            f"As 95 % intervals of a share, if pairs were independent: {', '.join(intervals)}."
        )
    return [*sentences, *_heaps_of_physics(table, [f"{pair}, physics" for pair in pairs])]


def _heaps_of_physics(table: Table, labels: Iterable[str]) -> list[str]:
    """Where physics alone, which the paper calls free of collapse, has particles in one place."""
    shares = table.numbers("overlap_h10", labels)
    many = {label: share for label, share in shares.items() if share > 0.1}
    if not many:
        return []
    rows = ", ".join(f"{share:.1%} ({label})" for label, share in many.items())
    return [f"Particles of physics closer than h/10 to another: {rows} (the paper: none)."]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def _scatter(table: Table) -> list[str]:
    score = compare(table, table.groups, "{}, joint", "{}, physics")
    return [f"{score} pairs lie below the diagonal (the paper: {CLAIMS['pairs_two_sided']})."]


def _dragon(table: Table) -> list[str]:
    ends = table.numbers("two_sided")
    coarse, fine = (ends.get(f"Physics, {edge} per edge") for edge in (3, 4))
    joint, joint_fine = (
        ends.get("Joint, 3 per edge"),
        ends.get("Joint, 4 per edge, native settings"),
    )
    sentences = []
    if coarse and joint_fine:
        sentences.append(
            f"Joint at 4 points per edge is {coarse / joint_fine:.2f} times better than physics at "
            f"3 (the paper: {CLAIMS['dragon_gain']:.1f})."
        )
    if coarse and fine:
        sentences.append(
            f"Physics alone gains {coarse / fine:.2f} times from the same change of resolution."
        )
    if fine and joint_fine:
        gain = fine / joint_fine
        sentences.append(f"At equal resolution joint gains {gain:.2f} times over physics.")
    if coarse and joint:
        word = "better" if joint < coarse else "not better"
        sentences.append(f"At 3 points per edge joint is {word} (the paper: worse).")
    return [*sentences, *_dragon_collapse(table)]


def _dragon_collapse(table: Table) -> list[str]:
    """The paper's four sentences on DCO and the dragon, each beside our numbers."""
    coarse = ("DCO, 3 per edge", "DCD, 3 per edge", "Physics, 3 per edge", "Joint, 3 per edge")
    fine = ("DCO, 4 per edge", "Physics, 4 per edge")
    if not all(table.ours(label, "two_sided") for label in (*coarse, *fine)):
        return []
    two_sided, hausdorff, f1 = (
        table.numbers(metric, (*coarse, *fine)) for metric in ("two_sided", "hausdorff", "f1")
    )
    dco, dcd, physics, _ = coarse
    lowest = min(coarse, key=lambda label: f1[label])
    return [
        f"DCO's two-sided distance is {two_sided[dco] / two_sided[physics]:.2f} times that of "
        f"physics at 3 points per edge and {two_sided[fine[0]] / two_sided[fine[1]]:.2f} "
        "times at 4 (the paper: 2.1 times).",
        f"Hausdorff: DCO {hausdorff[dco]:.3f}, physics {hausdorff[physics]:.3f} (the paper: DCO "
        f"lower). The lowest F1 at 3 per edge is that of {lowest.partition(',')[0]}, "
        f"{f1[lowest]:.3f}; DCO has {f1[dco]:.3f} (the paper: DCO's is the lowest of all).",
        f"DCO {two_sided[dco]:.3f} and DCD {two_sided[dcd]:.3f} (the paper: equal, 0.660 and "
        "0.659).",
        *_heaps_of_physics(table, [physics, fine[1]]),
    ]


def _chance(table: Table) -> list[str]:
    score = compare(table, TARGETS, "{}, joint", "{}, physics")
    sentences = [
        f"In the mean over three seeds joint is better than physics in two-sided distance on "
        f"{score} targets (the paper: 4 of 4, one run each)."
    ]
    differences = []
    for target in TARGETS:
        physics, joint = (
            table.cell(f"{target}, {method}", "two_sided") for method in ("physics", "joint")
        )
        if physics.ours and joint.ours:
            deviation = _joint_deviation(physics, joint)
            differences.append(f"{joint.ours - physics.ours:+.4f} ± {deviation:.4f} on {target}")
    if differences:
        sentences.append(f"The means differ by {', '.join(differences)}.")
    paired = _paired(table, TARGETS)
    return [*sentences, f"Paired by seed: {_differences(paired)}"] if paired else sentences


def _joint_deviation(*cells: Cell) -> float:
    return math.hypot(*(cell.deviation or 0 for cell in cells))


def _ablation(table: Table) -> list[str]:
    full = table.cell("Full method", "two_sided")
    if full.ours is None or full.deviation is None:
        return []
    beyond = []
    for line in table.lines:
        cell = line.cells["two_sided"]
        if line.row.group == "joint" and cell.ours is not None and cell.deviation is not None:
            change = cell.ours - full.ours
            if abs(change) > 2 * _joint_deviation(full, cell):
                beyond.append(f"{line.row.label} ({change:+.3f})")
    sentences = [
        f"The full method ends at {full.ours:.4f} ± {full.deviation:.4f}. Beyond twice the joint "
        f"deviation of the repeats lie {', '.join(beyond) or 'no variants'}; in the paper every "
        "variant is 0.010 to 0.019 worse."
    ]
    physics = table.ours("Physics", "two_sided")
    override = table.ours("Physics, smoothing 0.7 from frame 15", "two_sided")
    if physics and override and physics != full.ours:
        share = (physics - override) / (physics - full.ours)
        sentences.append(
            f"The smoothing of the joint runs alone takes physics from {physics:.4f} to "
            f"{override:.4f}, {share:.0%} of what the full method gains."
        )
    return sentences


def _overlap(table: Table) -> list[str]:
    labels = ("DCD, 3 per edge", "DCD, 4 per edge", "Joint, 3 per edge")
    shares = [f"{x:.1%} in {label}" for label, x in table.numbers("overlap_01", labels).items()]
    if not shares:
        return []
    return [
        f"Particles closer than 0.01 to another: {'; '.join(shares)} (the paper: 16.5% and 0%)."
    ]


def _convergence(table: Table) -> list[str]:
    fine = compare(table, TARGETS, "{}, Joint, 3 per edge", "{}, DCO, 4 per edge", "s2t")
    usual = compare(table, TARGETS, "{}, Joint, 3 per edge", "{}, DCO, 3 per edge", "s2t")
    return [
        f"At the last frame joint is closer in s→t than DCO as the paper runs it (at 4 points per "
        f"edge) on {fine} targets, and than DCO at its own resolution on {usual}."
    ]


def _teaser(table: Table) -> list[str]:
    ends = [f"{label} {distance:.3f}" for label, distance in table.numbers("two_sided").items()]
    return [f"Two-sided distance at the end: {', '.join(ends)}."] if ends else []


def _fairness(table: Table) -> list[str]:
    sentences = []
    dco, converged, physics, joint = (
        table.ours(label, "two_sided") for label in ("DCO", "DCO, converged", "Physics", "Joint")
    )
    if dco and converged and physics and joint:
        sentences.append(
            f"At equal resolution DCO ends at {dco:.3f}, converged at {converged:.3f}, physics at "
            f"{physics:.3f}, joint at {joint:.3f}: by Chamfer distance alone DCO is "
            f"{'not ' if converged > min(physics, joint) else ''}the best of them."
        )
    labels = ("DCO", "DCO, converged", "Shared basis, converged", "Physics", "Joint")
    overlaps = [f"{label} {x:.1%}" for label, x in table.numbers("overlap_01", labels).items()]
    if overlaps:
        sentences.append(f"Particles that coincide with another: {', '.join(overlaps)}.")
    return sentences


def _literal(table: Table) -> list[str]:
    """Whether the text's own parameters give its numbers."""
    escaped = table.numbers("escaped")
    ends = [
        f"{label} {distance:.3f} ({escaped[label]:.0f} particles out of the domain)"
        for label, distance in table.numbers("two_sided").items()
        if label in escaped
    ]
    return [f"Two-sided distance at the end: {'; '.join(ends)}."] if ends else []


def _rest(table: Table) -> list[str]:
    """Who is nearer at rest, and coincidence apart from starvation."""
    score = compare(table, table.groups, "{}, physics", "{}, DCO at rest")
    if not score.count:
        return []
    sentences = [
        f"DCO at rest ends above physics on {score} pairs ({score.interval} as a 95 % interval); "
        f"below it on {_listed(score.worse)}."
    ]
    free: list[str] = []
    bound: list[float] = []
    overlap, floors = table.numbers("overlap_01"), table.numbers(FLOOR)
    for label in overlap.keys() & floors.keys():
        if not label.endswith("at rest"):
            continue
        if floors[label]:
            bound.append(overlap[label] - floors[label])
        else:
            free.append(label)
    if free:
        shares = [overlap[label] for label in free]
        unused = [1 - share for share in table.numbers("targets_used", free).values()]
        low = table.numbers("rho_p05", free).values()
        sentences.append(
            f"Where particles do not outnumber points, {len(free)} pairs, {min(shares):.1%} to "
            f"{max(shares):.1%} of them coincide. There {min(unused):.1%} to {max(unused):.1%} of "
            "the target points are nobody's nearest, and the 5 % quantile of the density is "
            f"{min(low):.3f} to {max(low):.3f}."
        )
    if bound:
        sentences.append(
            f"Where they do, {len(bound)} pairs, {min(bound):+.1%} to {max(bound):+.1%} of all "
            "particles coincide beyond the floor."
        )
    falls = [
        1 - curve[-1] / curve[-11]
        for line in table.lines
        if line.row.label.endswith("at rest")
        if len(curve := _first_curve(line.records)) > 10
    ]
    if falls:
        sentences.append(
            "Over the last ten frames the two-sided distance falls by "
            f"{max(falls):.1%} at the most."
        )
    return sentences


def _repulsion(table: Table) -> list[str]:
    ends = [
        f"{label}: {share:.3f} coincide, 5 % quantile of the density {low:.3f}, IoU {iou:.3f}"
        for label, share in table.numbers("overlap_01").items()
        if (low := table.ours(label, "rho_p05")) is not None
        and (iou := table.ours(label, "iou")) is not None
    ]
    return [f"{'; '.join(ends)}."] if ends else []


def _seeds(table: Table) -> list[str]:
    """Paired differences with intervals, and what stands on one seed alone."""
    sentences = []
    differences = _paired(table, table.groups)
    better = [pair for pair, each in differences.items() if each.excludes_zero and each.mean < 0]
    worse = [pair for pair, each in differences.items() if each.excludes_zero and each.mean > 0]
    if differences:
        sentences.append(
            f"Of {len(table.groups)} pairs {len(differences)} have been run with several seeds. "
            f"Joint is nearer than physics, beyond the interval, on {len(better)} of them "
            f"({_listed(better)}), farther on {len(worse)} ({_listed(worse)}). "
            f"{_differences(differences)}"
        )
    swinging = [
        f"{label} (from {min(curve):.3f} to {curve[-1]:.3f} at the end)"
        for line in table.lines
        for label, curve in [(line.row.label, _first_curve(line.records))]
        if curve and curve[-1] > SWING * min(curve)
    ]
    if swinging:
        sentences.append(
            "A last frame far above the run's own least distance, which one seed cannot tell from "
            f"chance: {', '.join(swinging)}."
        )
    return sentences


SWING = 1.3
"""A run whose last frame is so many times farther than its nearest one is called an outlier."""


def _first_curve(records: Sequence[Record]) -> list[float]:
    return records[0].curves.get("two_sided", []) if records else []


def _paired(table: Table, names: Iterable[str]) -> dict[str, PairedDifference]:
    """Joint minus physics in two-sided distance by target or pair, where seeds repeat."""
    found = {
        name: paired_difference(table, f"{name}, joint", f"{name}, physics", "two_sided")
        for name in names
    }
    return {name: difference for name, difference in found.items() if difference is not None}


def _differences(differences: Mapping[str, PairedDifference]) -> str:
    parts = [f"{each} on {name}" for name, each in differences.items()]
    return f"Joint - physics, mean and 95 % interval: {', '.join(parts)}."


def _trial(table: Table) -> list[str]:
    score = compare(table, ["Joint"], "{}", "DCO")
    if not (score.better or score.worse):
        return []
    return [f"Joint ends {'below' if score.better else 'above'} DCO."]


FINDINGS: dict[str, Finding] = {
    "regularisers": _regularisers,
    "shapes": _shapes,
    "sphere": _sphere,
    "pairs": _pairs,
    "scatter": _scatter,
    "dragon": _dragon,
    "ablation": _ablation,
    "chance": _chance,
    "overlap": _overlap,
    "convergence": _convergence,
    "teaser": _teaser,
    "fairness": _fairness,
    "literal": _literal,
    "rest": _rest,
    "repulsion": _repulsion,
    "seeds": _seeds,
    "trial": _trial,
    "headline": extension_findings.headline,
    "transport": extension_findings.transport,
    "motion": extension_findings.motion,
    "ingredients": extension_findings.ingredients,
    "finer": extension_findings.bounds,
    "repeats": extension_findings.bounds,
    "objectives": extension_findings.objectives,
    "speeds": default_findings.speeds,
    "layers": default_findings.ends,
    "calm": default_findings.ends,
    "reverse": default_findings.reverse,
}
