"""Every number we print, defined once: the catalogue, and what two point sets tell of each other.

Particles x_p (N of them) are compared with target points q_j (M of them) by exact nearest
neighbours in float64::

    d_fwd(p) = min_j |x_p - q_j|        d_rev(j) = min_p |x_p - q_j|
    d_other(p) = min_{r != p} |x_p - x_r|

[condition] is 1 where it holds and 0 elsewhere; #S is the number of elements of S. Lengths are in
grid units (dx). A target that is a lattice of spacing h has floors: a particle dropped at random
inside it is h/2 (rms) from the nearest lattice point, so compare these numbers only at equal h, or
divided by h (algorithm 9.1). `morph_engine.metrics.fill` has the floor-free numbers.

Particles with a non-finite coordinate are counted in ``escaped`` and nowhere else: they take part
in no distance or share, and N is the number of the others. With no finite particle at all, every
metric takes its worst value: distances are inf, shares 0 where higher is better, 1 where lower is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from morph_engine.errors import MeshError

__all__ = [
    "COVERING_RADIUS_OVER_H",
    "METRICS",
    "Definition",
    "chamfer_metrics",
    "deformation_metrics",
    "determinants",
    "finite_points",
    "target_points",
]

Points = npt.NDArray[np.float64]

COVERING_RADIUS_OVER_H = 0.87
"""Just over half the diagonal of a lattice cell, in units of h: balls of this radius around the
points of a perfect fill leave no hole (algorithm 9.2)."""


@dataclass(frozen=True)
class Definition:
    """What one number means.

    Attributes:
        formula: Plain-text formula in the notation of this module.
        unit: ``dx`` (grid units), ``dx^2``, ``dx/s``, ``h`` (sample spacings), ``share`` (0 to 1),
            ``count``, ``ratio``, ``energy`` (mass dx^2 / s^2) or ``-`` (a pure number).
        better: Direction of improvement: ``lower``, ``higher``, or ``one`` (the nearer to 1).
        meaning: What the number tells, in a few words.
    """

    formula: str
    unit: Literal["dx", "dx^2", "dx/s", "s", "h", "share", "count", "ratio", "energy", "-"]
    better: Literal["lower", "higher", "one"]
    meaning: str


METRICS: dict[str, Definition] = {
    # nearest neighbours (algorithm 9)
    "s2t": Definition(
        "sqrt(mean_p d_fwd^2)", "dx", "lower", "how far particles are from the target"
    ),
    "t2s": Definition(
        "sqrt(mean_j d_rev^2)", "dx", "lower", "how far the target is from particles"
    ),
    "two_sided": Definition(
        "sqrt(mean_p d_fwd^2 + mean_j d_rev^2)", "dx", "lower", "Chamfer distance, root-sum form"
    ),
    "s2t_over_h": Definition("s2t / h", "h", "lower", "s2t, comparable across resolutions"),
    "t2s_over_h": Definition("t2s / h", "h", "lower", "t2s, comparable across resolutions"),
    "two_sided_over_h": Definition(
        "two_sided / h", "h", "lower", "two_sided, comparable across resolutions"
    ),
    "hausdorff": Definition(
        "max(max_p d_fwd, max_j d_rev)", "dx", "lower", "the worst point of either set"
    ),
    "precision": Definition(
        "mean_p [d_fwd < tau]", "share", "higher", "particles close to the target"
    ),
    "recall": Definition(
        "mean_j [d_rev < tau]", "share", "higher", "target points close to a particle"
    ),
    "f1": Definition(
        "2 precision recall / (precision + recall)",
        "share",
        "higher",
        "harmonic mean of precision and recall, 0 if both are 0",
    ),
    "coverage": Definition(
        "mean_j [d_rev < 0.87 h]", "share", "higher", "target points that are not in a hole"
    ),
    # collapse
    "overlap_01": Definition(
        "mean_p [d_other < 0.01]",
        "share",
        "lower",
        "particles that coincide with another",
    ),
    "overlap_h10": Definition(
        "mean_p [d_other < 0.1 h]",
        "share",
        "lower",
        "particles that nearly coincide with another",
    ),
    "least_gap": Definition(
        "min(1, min_p d_other / h)",
        "h",
        "higher",
        "smallest distance of two particles; not told apart beyond h",
    ),
    "many_to_one": Definition(
        "#{j : j is nearest to some p} / N",
        "share",
        "higher",
        "distinct nearest targets per particle; 1 when no two particles share one",
    ),
    "targets_used": Definition(
        "#{j : j is nearest to some p} / M",
        "share",
        "higher",
        "target points that are the nearest one of some particle",
    ),
    # state
    "escaped": Definition(
        "#{p : x_p not in [-d, d]^3}",
        "count",
        "lower",
        "particles outside the domain of half edge d, where runs with a grid end",
    ),
    "det_f_min": Definition(
        "min_p det F_p", "ratio", "one", "strongest compression; <= 0 is an inverted particle"
    ),
    "det_f_max": Definition("max_p det F_p", "ratio", "one", "strongest expansion"),
    "det_f_mean": Definition(
        "mean_p det F_p", "ratio", "one", "volume over volume at rest, as far as the grid moved it"
    ),
    "max_move": Definition(
        "max_p norm(x_p - x_p of the frame before)", "dx", "lower", "farthest way in a frame"
    ),
    "max_speed": Definition("max_p norm(v_p)", "dx/s", "lower", "fastest particle"),
    "kinetic_energy": Definition(
        "1/2 sum_p m_p norm(v_p)^2", "energy", "lower", "motion left in the cloud"
    ),
    # what the optimiser sees (algorithm 3, 5.1)
    "loss_physics": Definition(
        "1/2 sum_i (ln(M_i + 1 + eps) - ln(M*_i + 1 + eps))^2",
        "-",
        "lower",
        "grid mass loss over all nodes i, eps = 1e-4",
    ),
    "loss_chamfer": Definition(
        "mean_p l(d_fwd) + w_rev mean_j l(d_rev)",
        "-",
        "lower",
        "Chamfer loss before its weight, l quadratic then linear",
    ),
    "loss_points": Definition(
        "1/2 (mean_p omega_p d_fwd^2 + mean_j omega_j d_rev^2) + regularisers",
        "dx^2",
        "lower",
        "objective of methods that move points; of density_aware, swd and sinkhorn their distance",
    ),
    "loss_transport": Definition(
        "mean_p norm(x_p - y_p)^2",
        "dx^2",
        "lower",
        "how far `transport` is from where its particles belong by now, y_p",
    ),
    "correction": Definition(
        "mean_p sum of norm(moves beyond the motion of the grid in the frame)",
        "dx",
        "lower",
        "what `transport` mends of the motion in a frame",
    ),
    # how the frame was computed
    "dt": Definition("dt", "s", "higher", "time step, halved where a trial failed"),
    "accepted_steps": Definition(
        "#{steps taken}", "count", "higher", "control steps of the frame that improved it"
    ),
    "failed_steps": Definition(
        "#{steps refused}", "count", "lower", "control steps of which every trial was rejected"
    ),
    # fill of the volume (algorithm 9.2)
    "iou": Definition("#(A n B) / #(A u B)", "share", "higher", "volume overlap of the two fills"),
    "cover": Definition(
        "#(A n B) / #B", "share", "higher", "part of the target's volume that is filled"
    ),
    "spill": Definition(
        "#(A - B) / #A", "share", "lower", "part of the fill outside the target's volume"
    ),
}
METRICS |= {
    f"rho_p{percent:02}": Definition(
        f"{percent} % quantile of rho_j",
        "ratio",
        "one",
        f"density ratio that {percent} % of the target points stay below",
    )
    for percent in (1, 5, 50, 95, 99)
}
METRICS |= {
    # against the target's mesh, of winding number w and surface S
    "outside_share": Definition(
        "mean_p [w(x_p) < 1/2]", "share", "lower", "particles outside the target mesh"
    ),
    "outside_mean": Definition(
        "mean_{p outside} d_S(x_p)", "dx", "lower", "how far those are from its surface, 0 if none"
    ),
    "outside_max": Definition(
        "max_{p outside} d_S(x_p)", "dx", "lower", "the farthest of those, 0 if none"
    ),
}


def finite_points(positions: npt.ArrayLike) -> tuple[Points, npt.NDArray[np.bool_]]:
    """Split off particles that have no usable position.

    Args:
        positions: Particle positions [dx], shape [n, 3], any float type.

    Returns:
        The finite positions [dx], shape [k, 3], float64, and the mask [n] that selects them.

    Raises:
        MeshError: The shape is not [n, 3].
    """
    points = np.asarray(positions)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(
            f"A point cloud has shape {list(points.shape)}.",
            "Pass one row of x, y, z per point, shape [n, 3].",
        )
    finite = np.isfinite(points).all(axis=1)
    return points[finite].astype(np.float64), finite


def target_points(target: npt.ArrayLike) -> Points:
    """Check a target cloud, which unlike a running simulation has no excuse.

    Args:
        target: Target points [dx], shape [m, 3], any float type.

    Returns:
        The points [dx], shape [m, 3], float64.

    Raises:
        MeshError: The shape is not [m, 3], there is no point, or one is not finite.
    """
    points, finite = finite_points(target)
    if not finite.all():
        raise MeshError(
            f"{np.count_nonzero(~finite)} target points are not finite.",
            "Remove the rows with NaN or infinite coordinates.",
        )
    if not len(points):
        raise MeshError("The target has no points.", "Pass at least one target point.")
    return points


def distance_to_other(
    distinct: Points,
    copies: npt.NDArray[np.intp],
    tree: cKDTree,
    *,
    bound: float = math.inf,
    workers: int = 1,
) -> Points:
    """Distance from each point to the nearest other one [dx], shape [k].

    Identical points are told apart first: a tree cannot split them, and searching them is O(n^2).

    Args:
        distinct: Points, no two of them equal [dx], shape [k, 3], float64.
        copies: How many there are of each, shape [k].
        tree: Tree of the distinct points.
        bound: Distances beyond this are infinite [dx].
        workers: Threads; -1 takes every core.
    """
    gap, _ = tree.query(distinct, k=[2], distance_upper_bound=bound, workers=workers)
    return np.where(copies > 1, 0.0, gap[:, 0])


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
    inside = np.count_nonzero((np.abs(points) <= domain_half_extent).all(axis=1))
    escaped = {"escaped": float(len(finite) - inside)}
    if count == 0:
        return _worst() | escaped

    distinct, copies = np.unique(points, axis=0, return_counts=True)
    tree = cKDTree(distinct)

    if d_fwd is None or nearest_fwd is None:
        forward, nearest = cKDTree(goal).query(points, workers=workers)
    else:
        forward, nearest = np.asarray(d_fwd)[finite], np.asarray(nearest_fwd)[finite]
    if d_rev is None:
        reverse, _ = tree.query(goal, workers=workers)
    else:
        reverse = np.asarray(d_rev)
    forward, reverse = forward.astype(np.float64), reverse.astype(np.float64)

    forward_mean, reverse_mean = float(np.mean(forward**2)), float(np.mean(reverse**2))
    chamfer = {
        "s2t": math.sqrt(forward_mean),
        "t2s": math.sqrt(reverse_mean),
        "two_sided": math.sqrt(forward_mean + reverse_mean),
    }
    precision, recall = float(np.mean(forward < tau)), float(np.mean(reverse < tau))
    radius = COVERING_RADIUS_OVER_H * spacing if coverage_radius is None else coverage_radius
    target_count = np.unique(nearest).size

    close = (0.01, 0.1 * spacing)
    gap = distance_to_other(distinct, copies, tree, bound=max(*close, spacing), workers=workers)
    overlap_01, overlap_h10 = (float(copies[gap < limit].sum()) / count for limit in close)

    return (
        chamfer
        | {f"{name}_over_h": value / spacing for name, value in chamfer.items()}
        | {
            "hausdorff": float(max(forward.max(), reverse.max())),
            "precision": precision,
            "recall": recall,
            "f1": 2 * precision * recall / (precision + recall) if precision + recall else 0.0,
            "coverage": float(np.mean(reverse < radius)),
            "overlap_01": overlap_01,
            "overlap_h10": overlap_h10,
            "least_gap": min(1.0, float(gap.min()) / spacing),
            "many_to_one": target_count / count,
            "targets_used": target_count / len(goal),
        }
        | escaped
    )


def determinants(deformation: npt.ArrayLike) -> Points:
    """det F of each particle.

    Args:
        deformation: Deformation gradients F [-], shape [n, 3, 3].

    Returns:
        Determinants [ratio], shape [n], float64.

    Raises:
        ValueError: The shape is not [n, 3, 3] with n > 0.
    """
    gradients = np.asarray(deformation, dtype=np.float64)
    if gradients.ndim != 3 or gradients.shape[1:] != (3, 3) or not len(gradients):
        raise ValueError(f"F has shape {list(gradients.shape)}, expected [n, 3, 3] with n > 0")
    # the rows' triple product: exact on the identity, and quiet where LAPACK warns of NaN
    with np.errstate(invalid="ignore", over="ignore"):
        det: Points = np.einsum(
            "pi,pi->p", gradients[:, 0], np.cross(gradients[:, 1], gradients[:, 2])
        )
    return det


def deformation_metrics(deformation: npt.ArrayLike) -> dict[str, float]:
    """Range and mean of det F over the particles.

    Args:
        deformation: Deformation gradients F [-], shape [n, 3, 3].

    Returns:
        ``det_f_min``, ``det_f_max`` and ``det_f_mean``. A non-finite determinant counts as the
        worst value of each, -inf, inf and inf.

    Raises:
        ValueError: The shape is not [n, 3, 3] with n > 0.
    """
    det = determinants(deformation)
    known = np.isfinite(det)
    return {
        "det_f_min": float(np.where(known, det, -np.inf).min()),
        "det_f_max": float(np.where(known, det, np.inf).max()),
        "det_f_mean": float(np.where(known, det, np.inf).mean()),
    }


def _worst() -> dict[str, float]:
    """Values of `chamfer_metrics` when no particle has a finite position."""
    lengths = ("s2t", "t2s", "two_sided")
    return (
        dict.fromkeys((*lengths, *(f"{name}_over_h" for name in lengths), "hausdorff"), math.inf)
        | dict.fromkeys(("precision", "recall", "f1", "coverage"), 0.0)
        | dict.fromkeys(("overlap_01", "overlap_h10"), 1.0)
        | dict.fromkeys(("least_gap", "many_to_one", "targets_used"), 0.0)
    )
