"""Every number we print, defined once.

Particles x_p (N of them) are compared with target points q_j (M of them) by exact nearest
neighbours in float64::

    d_fwd(p) = min_j |x_p - q_j|        d_rev(j) = min_p |x_p - q_j|
    d_other(p) = min_{r != p} |x_p - x_r|

[condition] is 1 where it holds and 0 elsewhere; #S is the number of elements of S. Lengths are in
grid units (dx). A target that is a lattice of spacing h has floors: a particle dropped at random
inside it is h/2 (rms) from the nearest lattice point, so compare these numbers only at equal h, or
divided by h (algorithm 9.1). `morph_engine.metrics.volume` has the floor-free numbers.

Particles with a non-finite coordinate are counted in ``escaped`` and nowhere else: they take part
in no distance or share, and N is the number of the others. With no finite particle at all, every
metric takes its worst value: inf where lower is better, but 1 if it is a share; 0 where higher is
better, or 1 is best. Other counts are then 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class MetricDefinition:
    """What one number means.

    Attributes:
        formula: Plain-text formula in the notation of this module.
        unit: ``dx`` (grid units), ``dx^2``, ``dx/s``, ``h`` (sample spacings), ``share`` (0 to 1),
            ``count``, ``ratio``, ``energy`` (mass dx^2 / s^2), ``degrees`` or
            ``-`` (a pure number).
        better: Direction of improvement: ``lower``, ``higher``, or ``one`` (the nearer to 1).
        meaning: What the number tells, in a few words.
    """

    formula: str
    unit: Literal[
        "dx", "dx^2", "dx/s", "s", "h", "h^2", "share", "count", "ratio", "energy", "degrees", "-"
    ]
    better: Literal["lower", "higher", "one"]
    meaning: str

    @property
    def worst(self) -> float:
        """Value of a measure of positions where no particle is left.

        0 where higher is better or 1 is best, and for counts; else 1 for a share, inf for others.
        """
        if self.better != "lower" or self.unit == "count":
            return 0.0
        return 1.0 if self.unit == "share" else math.inf


METRICS: dict[str, MetricDefinition] = {
    # nearest neighbours (algorithm 9)
    "s2t": MetricDefinition(
        "sqrt(mean_p d_fwd^2)", "dx", "lower", "how far particles are from the target"
    ),
    "t2s": MetricDefinition(
        "sqrt(mean_j d_rev^2)", "dx", "lower", "how far the target is from particles"
    ),
    "two_sided": MetricDefinition(
        "sqrt(mean_p d_fwd^2 + mean_j d_rev^2)", "dx", "lower", "Chamfer distance, root-sum form"
    ),
    "s2t_over_h": MetricDefinition("s2t / h", "h", "lower", "s2t, comparable across resolutions"),
    "t2s_over_h": MetricDefinition("t2s / h", "h", "lower", "t2s, comparable across resolutions"),
    "two_sided_over_h": MetricDefinition(
        "two_sided / h", "h", "lower", "two_sided, comparable across resolutions"
    ),
    "hausdorff": MetricDefinition(
        "max(max_p d_fwd, max_j d_rev)", "dx", "lower", "the worst point of either set"
    ),
    "precision": MetricDefinition(
        "mean_p [d_fwd < tau]", "share", "higher", "particles close to the target"
    ),
    "recall": MetricDefinition(
        "mean_j [d_rev < tau]", "share", "higher", "target points close to a particle"
    ),
    "f1": MetricDefinition(
        "2 precision recall / (precision + recall)",
        "share",
        "higher",
        "harmonic mean of precision and recall, 0 if both are 0",
    ),
    "coverage": MetricDefinition(
        "mean_j [d_rev < 0.87 h]", "share", "higher", "target points that are not in a hole"
    ),
    # collapse
    "overlap_01": MetricDefinition(
        "mean_p [d_other < 0.01]",
        "share",
        "lower",
        "particles that coincide with another",
    ),
    "overlap_h10": MetricDefinition(
        "mean_p [d_other < 0.1 h]",
        "share",
        "lower",
        "particles that nearly coincide with another",
    ),
    "least_gap": MetricDefinition(
        "min(1, min_p d_other / h)",
        "h",
        "higher",
        "smallest distance between two particles, capped at h",
    ),
    "many_to_one": MetricDefinition(
        "#{j : j is nearest to some p} / N",
        "share",
        "higher",
        "distinct nearest target points per particle; 1 if no two particles share one",
    ),
    "targets_used": MetricDefinition(
        "#{j : j is nearest to some p} / M",
        "share",
        "higher",
        "target points that are the nearest one of some particle",
    ),
    # state
    "escaped": MetricDefinition(
        "#{p : x_p not in [-d, d]^3}",
        "count",
        "lower",
        "particles outside the domain of half edge d, where runs with a grid end",
    ),
    "det_f_min": MetricDefinition(
        "min_p det F_p", "ratio", "one", "strongest compression; <= 0 is an inverted particle"
    ),
    "det_f_max": MetricDefinition("max_p det F_p", "ratio", "one", "strongest expansion"),
    "det_f_mean": MetricDefinition(
        "mean_p det F_p", "ratio", "one", "volume over volume at rest, as far as the grid moved it"
    ),
    "max_move": MetricDefinition(
        "max_p norm(x_p - x_p of the frame before)", "dx", "lower", "longest move in a frame"
    ),
    "max_speed": MetricDefinition("max_p norm(v_p)", "dx/s", "lower", "fastest particle"),
    "kinetic_energy": MetricDefinition(
        "1/2 sum_p m_p norm(v_p)^2", "energy", "lower", "remaining motion"
    ),
    # what the optimiser sees (algorithm 3, 5.1)
    "loss_physics": MetricDefinition(
        "1/2 sum_i (ln(M_i + 1 + eps) - ln(M*_i + 1 + eps))^2",
        "-",
        "lower",
        "grid mass loss over all nodes i, eps = 1e-4",
    ),
    "loss_chamfer": MetricDefinition(
        "mean_p l(d_fwd) + w_rev mean_j l(d_rev)",
        "-",
        "lower",
        "Chamfer loss before its weight, l quadratic then linear",
    ),
    "loss_points": MetricDefinition(
        "1/2 (mean_p omega_p d_fwd^2 + mean_j omega_j d_rev^2) + regularisers",
        "dx^2",
        "lower",
        "objective of methods that move points; for density_aware, swd and sinkhorn their distance",
    ),
    "loss_transport": MetricDefinition(
        "mean_p norm(x_p - y_p)^2",
        "dx^2",
        "lower",
        "how far particles of `transport` are from where they should be by now, y_p",
    ),
    "correction": MetricDefinition(
        "mean_p sum of norm(moves beyond the motion of the grid in the frame)",
        "dx",
        "lower",
        "motion that `transport` corrects in a frame; for `flow`, moves that even out the fill",
    ),
    # how the frame was computed
    "dt": MetricDefinition("dt", "s", "higher", "time step, halved where a trial failed"),
    "pressure_residual": MetricDefinition(
        "max_steps max_k abs(r_k) / max_k abs(b_k)",
        "ratio",
        "lower",
        "largest residual of the pressure of `flow` in the frame over its right-hand side b; 0.01 "
        "is asked for",
    ),
    "accepted_steps": MetricDefinition(
        "#{steps taken}", "count", "higher", "control steps of the frame that improved it"
    ),
    "failed_steps": MetricDefinition(
        "#{steps refused}", "count", "lower", "control steps whose trials were all rejected"
    ),
    # fill of the volume (algorithm 9.2)
    "iou": MetricDefinition(
        "#(A n B) / #(A u B)", "share", "higher", "volume overlap of the two fills"
    ),
    "cover": MetricDefinition(
        "#(A n B) / #B", "share", "higher", "part of the target's volume that is filled"
    ),
    "spill": MetricDefinition(
        "#(A - B) / #A", "share", "lower", "part of the fill outside the target's volume"
    ),
}
METRICS |= {
    f"rho_p{percent:02}": MetricDefinition(
        f"{percent} % quantile of rho_j",
        "ratio",
        "one",
        f"density ratio that {percent} % of the target points are below",
    )
    for percent in (1, 5, 50, 95, 99)
}
METRICS |= {
    # against the target's mesh, of winding number w and surface S
    "outside_share": MetricDefinition(
        "mean_p [w(x_p) < 1/2]", "share", "lower", "particles outside the target mesh"
    ),
    "outside_mean": MetricDefinition(
        "mean_{p outside} d_S(x_p)",
        "dx",
        "lower",
        "mean distance of these from its surface, 0 if none",
    ),
    "outside_max": MetricDefinition(
        "max_{p outside} d_S(x_p)", "dx", "lower", "largest distance of these, 0 if none"
    ),
}
METRICS |= {
    # the path: bodies A_t, and their schedule from end to end
    "area_min": MetricDefinition(
        "min_t area(A_t) / schedule",
        "ratio",
        "one",
        "a path that melts features away before it grows others",
    ),
    "area_max": MetricDefinition(
        "max_t area(A_t) / schedule",
        "ratio",
        "one",
        "a path that tears, frays or shows limbs twice",
    ),
    "volume_min": MetricDefinition(
        "min_t volume(A_t) / schedule",
        "ratio",
        "one",
        "matter compressed on the way",
    ),
    "volume_max": MetricDefinition(
        "max_t volume(A_t) / schedule",
        "ratio",
        "one",
        "matter spread thin on the way",
    ),
    "more_pieces": MetricDefinition(
        "max_t #{pieces of A_t} - the larger number of both ends",
        "count",
        "lower",
        "crumbs on the way, down to a single particle",
    ),
    "more_euler": MetricDefinition(
        "max_t Euler number of the surface beyond both ends",
        "count",
        "lower",
        "holes, bubbles and bodies that neither end has; each counts 2",
    ),
    "d2_min": MetricDefinition(
        "mean_p min_F mean_q norm(y_q - y_p - F (x_q - x_p))^2 / h^2",
        "h^2",
        "lower",
        "how far neighbours q are shuffled, apart from rotation and stretch",
    ),
    "kept": MetricDefinition(
        "mean_p #{neighbours at the start that are so at the end} / 12",
        "share",
        "higher",
        "neighbours that remain neighbours",
    ),
    "gap_p01": MetricDefinition(
        "min_t 1 % quantile of d_other / h",
        "h",
        "higher",
        "how close particles pass each other",
    ),
    "gap_min": MetricDefinition(
        "min_t min_p d_other / h",
        "h",
        "higher",
        "closest approach of two particles",
    ),
    "geodesic": MetricDefinition(
        "rms(g_1 - g_0) / mean(g_0)",
        "ratio",
        "lower",
        "change of shortest paths g inside the body: similar parts that separate",
    ),
    "detour": MetricDefinition(
        "sum_p length of path / sum_p norm(y_p - x_p)",
        "ratio",
        "lower",
        "how much longer the paths are than straight lines",
    ),
    "action": MetricDefinition(
        "(sum_t rms_p step)^2 / mean_p norm(y_p - x_p)^2",
        "ratio",
        "lower",
        "kinetic action over its lower bound, both with the best timing",
    ),
    "settled": MetricDefinition(
        "sum_p length of moves beyond the simulation / sum_p length of path",
        "share",
        "lower",
        "share of motion not made by the simulation",
    ),
    "local_volume": MetricDefinition(
        "median_p (rho_0 / rho_1) / schedule",
        "ratio",
        "one",
        "how much room particles have at the end, from the positions of their neighbours",
    ),
    "det_f_off": MetricDefinition(
        "mean_p abs(mean_q det F_q * rho_1 / rho_0 - 1)",
        "ratio",
        "lower",
        "difference between det F and the change of the local volume",
    ),
    # the end against the mesh itself, by random points z of its volume
    "dense_t2s": MetricDefinition(
        "sqrt(mean_z d(z)^2)",
        "dx",
        "lower",
        "how far the target's volume is from particles",
    ),
    "dense_floor": MetricDefinition(
        "(V / N)^(1/3) / 2",
        "dx",
        "lower",
        "`dense_t2s` of as many particles on a cubic lattice",
    ),
    "dense_s2t": MetricDefinition(
        "sqrt(mean_p min_z norm(x_p - z)^2)",
        "dx",
        "lower",
        "how far particles are from the target's volume",
    ),
    "dense_s2t_floor": MetricDefinition(
        "sqrt(mean_z min over z' != z of norm(z - z')^2)",
        "dx",
        "lower",
        "`dense_s2t` of particles at random places inside the target",
    ),
    "covered": MetricDefinition(
        "mean_z [d(z) < 0.87 h]",
        "share",
        "higher",
        "target volume that is not in a hole",
    ),
    "mesh_iou": MetricDefinition(
        "volume(A n mesh) / volume(A u mesh)",
        "share",
        "higher",
        "overlap of the body with the mesh, including where the balls stick out",
    ),
    "mesh_iou_level": MetricDefinition(
        "the same, A offset to the mesh's volume",
        "share",
        "higher",
        "overlap of the body with the mesh",
    ),
    "density_p05": MetricDefinition(
        "5 % quantile of rho(z)",
        "ratio",
        "one",
        "density ratio that 5 % of the target's volume is below",
    ),
    "density_p95": MetricDefinition(
        "95 % quantile of rho(z)",
        "ratio",
        "one",
        "density ratio that 95 % of the target's volume is below",
    ),
    "surface_mean": MetricDefinition(
        "max(mean d_S from the surface, mean d_S back)",
        "dx",
        "lower",
        "how far the reconstructed surface is from the mesh",
    ),
    "surface_p95": MetricDefinition(
        "max(95 % quantile of d_S from the surface, of d_S back)",
        "dx",
        "lower",
        "distance that 95 % of the surface is below",
    ),
    "normal_mean": MetricDefinition(
        "mean angle(normal, normal at the nearest point)",
        "degrees",
        "lower",
        "how rough the reconstructed surface is",
    ),
}
