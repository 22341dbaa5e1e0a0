"""What the tables behind the presets show, in sentences made of their own numbers."""

from __future__ import annotations

from chamfer_morph.reproduction.report.tables import Table


def speeds(table: Table) -> list[str]:
    """The fastest particle of the first frames, row by row."""
    fastest = {
        line.row.label: max(found)
        for line in table.lines
        if (found := [cell.ours for cell in line.cells.values() if cell.ours is not None])
    }
    parts = [f"{label} {speed:.1f}" for label, speed in fastest.items()]
    return [f"Grid units per second in the first frames: {'; '.join(parts)}."] if parts else []


def ends(table: Table) -> list[str]:
    """How far each row ends from the target, the nearest first."""
    distances = table.numbers("two_sided")
    nearest = sorted(distances, key=lambda label: distances[label])
    parts = [f"{label} {distances[label]:.4f}" for label in nearest]
    return [f"Two-sided distance at the end: {'; '.join(parts)}."] if parts else []


def reverse(table: Table) -> list[str]:
    """On how many targets the reverse term does better unsmoothed."""
    sentences = []
    for metric, words, sign in (
        ("two_sided", "Two-sided distance is lower", 1),
        ("iou", "Volume overlap is larger", -1),
    ):
        numbers = table.pairs(table.groups, "{}, sigma 2", "{}, sigma 0", metric)
        if numbers:
            better = sum(sign * (smoothed - plain) > 0 for smoothed, plain in numbers.values())
            sentences.append(f"{words} without smoothing on {better} of {len(numbers)} targets.")
    return sentences
