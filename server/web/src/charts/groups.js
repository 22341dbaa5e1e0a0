/** Which metrics belong into one chart; docs/metrics.md has their definitions. */

/** `log` charts losses, which fall by orders of magnitude; `names` are those of the API. */
export const GROUPS = [
  {
    title: "Chamfer distance",
    unit: "dx",
    names: { two_sided: "two-sided", s2t: "s → t", t2s: "t → s" },
  },
  { title: "Hausdorff distance", unit: "dx", names: { hausdorff: "worst point" } },
  { title: "F1 and coverage", unit: "share", names: { f1: "F1", coverage: "coverage" } },
  {
    title: "Overlap",
    unit: "share of particles",
    names: { overlap_01: "below 0.01 dx", overlap_h10: "0.1 h" },
  },
  { title: "Closest particles", unit: "h", names: { least_gap: "smallest distance" } },
  { title: "det F", unit: "ratio", names: { det_f_min: "least", det_f_mean: "mean", det_f_max: "greatest" } },
  { title: "Motion", unit: "dx per frame", names: { max_move: "longest move" } },
  {
    title: "Losses",
    unit: "logarithmic",
    log: true,
    names: { loss_physics: "grid mass", loss_chamfer: "Chamfer", loss_points: "points" },
  },
];

/** Metrics of the last frame that tell how a job ended, and which way is better. */
export const FINAL = {
  two_sided: { label: "Chamfer distance", unit: "dx", better: "lower" },
  s2t: { label: "source to target", unit: "dx", better: "lower" },
  t2s: { label: "target to source", unit: "dx", better: "lower" },
  hausdorff: { label: "Hausdorff distance", unit: "dx", better: "lower" },
  f1: { label: "F1", unit: "share", better: "higher" },
  coverage: { label: "Coverage", unit: "share", better: "higher" },
  iou: { label: "Volume overlap", unit: "share", better: "higher" },
  overlap_01: { label: "Coinciding within 0.01 dx", unit: "share", better: "lower" },
  overlap_h10: { label: "Coinciding within 0.1 h", unit: "share", better: "lower" },
  least_gap: { label: "Smallest distance", unit: "h", better: "higher" },
  many_to_one: { label: "Distinct nearest targets", unit: "share", better: "higher" },
  rho_p05: { label: "Density, 5 % quantile", unit: "ratio", better: "one" },
  rho_p95: { label: "Density, 95 % quantile", unit: "ratio", better: "one" },
  det_f_min: { label: "det F, least", unit: "ratio", better: "one" },
  det_f_max: { label: "det F, greatest", unit: "ratio", better: "one" },
  outside_share: { label: "Outside the target", unit: "share", better: "lower" },
  escaped: { label: "Escaped particles", unit: "count", better: "lower" },
};
