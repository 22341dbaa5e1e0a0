"""What a whole result comes to, one number a metric."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.surface_reconstruction import reconstruct_surface, surface_deviation

if TYPE_CHECKING:
    from morph_engine.results.trajectory import Trajectory

EXTREMES: dict[str, Callable[[Iterable[float]], float]] = {
    "least_gap": min, "det_f_min": min, "det_f_max": max, "max_move": max,
}  # fmt: skip
"""Metrics whose worst value over all frames is told, too, with `_ever` after their name."""


def summarize(result: Trajectory) -> dict[str, float]:
    """The metrics of the last frame by name, the worst of all frames, and `surface_mean` [dx].

    Other units are those of `morph_engine.metrics.definitions.METRICS`.

    Raises:
        ResultError: The file is damaged.
    """
    return result.metrics_at(-1) | _worst(result) | _surface(result)


def _worst(result: Trajectory) -> dict[str, float]:
    """The worst of a trajectory, by the metrics of `EXTREMES`."""
    return {
        f"{name}_ever": float(worst(result.metrics[name]))
        for name, worst in EXTREMES.items()
        if name in result.metrics and not np.isnan(result.metrics[name]).any()
    }


def _surface(result: Trajectory) -> dict[str, float]:
    """How far the surface of the last frame of matter is from the target's, `surface_mean` [dx].

    In one direction, unlike `independent.surface_metrics`, and with the lattice spacing of the
    source: the records of the reproduction have it so.
    """
    target = result.run.target
    if "det_f_min" not in result.metrics or not isinstance(target, Mesh):
        return {}
    to_grid = np.linalg.inv(result.transform)
    vertices = target.vertices @ to_grid[:3, :3].T + to_grid[:3, 3]
    spacing = result.config.spacing
    found = reconstruct_surface(result.positions(-1), spacing)
    return {"surface_mean": surface_deviation(found, replace(target, vertices=vertices))["mean"]}
