"""Chamfer distances and what else nearest neighbours tell of two point sets (algorithm 9)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.geometry.point_cloud import (
    distance_to_other,
    distinct_points,
    finite_points,
    target_points,
)

COVERING_RADIUS_OVER_H = 0.87
"""Just over half the diagonal of a lattice cell, in units of h: balls of this radius around the
points of a perfect fill leave no hole (algorithm 9.2)."""


def chamfer_metrics(
    positions: npt.ArrayLike,
    target: npt.ArrayLike,
    *,
    spacing: float,
    tau: float = 0.2,
    coverage_radius: float | None = None,
    domain_half_extent: float = 14.0,
    d_fwd: npt.ArrayLike | None = None,
    nearest_fwd: npt.ArrayLike | None = None,
    d_rev: npt.ArrayLike | None = None,
    gap: npt.ArrayLike | None = None,
    workers: int = 1,
) -> dict[str, float]:
    """Nearest-neighbour metrics of one frame, cheap enough for every frame.

    Args:
        positions: Particle positions [dx], shape [n, 3].
        target: Target points [dx], shape [m, 3].
        spacing: Lattice spacing h of the target [dx].
        tau: Threshold of precision, recall and F1 [dx], strict.
        coverage_radius: Threshold of coverage [dx], strict; 0.87 h when not given.
        domain_half_extent: A particle beyond this in any coordinate has escaped [dx].
        d_fwd: Distances d_fwd where already known [dx], shape [n], not squared.
        nearest_fwd: Index of each particle's nearest target point, shape [n], integer.
        d_rev: Distances d_rev where already known [dx], shape [m], not squared.
        gap: Distance from each particle to the nearest other one where already known [dx], shape
            [n]; those that are not below h may be inf.
        workers: Threads for the searches; -1 takes every core.

    Returns:
        ``s2t``, ``t2s``, ``two_sided``, their ``*_over_h``, ``hausdorff``, ``precision``,
        ``recall``, ``f1``, ``coverage``, ``overlap_01``, ``overlap_h10``, ``least_gap``,
        ``many_to_one``, ``targets_used`` and ``escaped``, as defined in `METRICS` (algorithm 9).

    Raises:
        MeshError: Either array has the wrong shape, or the target is empty or not finite.
    """
    points, finite = finite_points(positions)
    goal = target_points(target)
    count = len(points)
    inside = np.abs(points) <= domain_half_extent
    inside_count = count if inside.all() else np.count_nonzero(inside.all(axis=1))
    escaped = {"escaped": float(len(finite) - inside_count)}
    if count == 0:
        return _worst() | escaped

    close = (0.01, 0.1 * spacing)
    if gap is None or d_rev is None or max(close) > spacing:
        distinct, copies = distinct_points(points)
        tree = scipy.spatial.cKDTree(distinct)
        if d_rev is None:
            d_rev, _ = tree.query(goal, workers=workers)
        gaps = distance_to_other(
            distinct, copies, tree, bound=max(*close, spacing), workers=workers
        )
        gaps = np.repeat(gaps, copies)
    else:
        gaps = np.asarray(gap)[finite]

    if d_fwd is None or nearest_fwd is None:
        forward, nearest = scipy.spatial.cKDTree(goal).query(points, workers=workers)
    else:
        forward, nearest = np.asarray(d_fwd)[finite], np.asarray(nearest_fwd)[finite]
    forward, reverse = forward.astype(np.float64), np.asarray(d_rev).astype(np.float64)

    forward_mean, reverse_mean = float(np.mean(forward**2)), float(np.mean(reverse**2))
    chamfer = {
        "s2t": math.sqrt(forward_mean),
        "t2s": math.sqrt(reverse_mean),
        "two_sided": math.sqrt(forward_mean + reverse_mean),
    }
    precision, recall = float(np.mean(forward < tau)), float(np.mean(reverse < tau))
    radius = COVERING_RADIUS_OVER_H * spacing if coverage_radius is None else coverage_radius
    target_count = np.count_nonzero(np.bincount(nearest, minlength=len(goal)))

    return (
        chamfer
        | {f"{name}_over_h": value / spacing for name, value in chamfer.items()}
        | {
            "hausdorff": float(max(forward.max(), reverse.max())),
            "precision": precision,
            "recall": recall,
            "f1": 2 * precision * recall / (precision + recall) if precision + recall else 0.0,
            "coverage": float(np.mean(reverse < radius)),
            "overlap_01": float(np.mean(gaps < close[0])),
            "overlap_h10": float(np.mean(gaps < close[1])),
            "least_gap": min(1.0, float(gaps.min()) / spacing),
            "many_to_one": target_count / count,
            "targets_used": target_count / len(goal),
        }
        | escaped
    )


def _worst() -> dict[str, float]:
    """Values of `chamfer_metrics` when no particle has a finite position."""
    lengths = ("s2t", "t2s", "two_sided")
    return (
        dict.fromkeys((*lengths, *(f"{name}_over_h" for name in lengths), "hausdorff"), math.inf)
        | dict.fromkeys(("precision", "recall", "f1", "coverage"), 0.0)
        | dict.fromkeys(("overlap_01", "overlap_h10"), 1.0)
        | dict.fromkeys(("least_gap", "many_to_one", "targets_used"), 0.0)
    )
