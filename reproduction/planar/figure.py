"""The picture of the planar experiment: where the points end, and which of them lie in a heap."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from chamfer_morph.reproduction.planar.config import PlanarConfig
from chamfer_morph.reproduction.planar.experiment import PlanarRun, Setting
from chamfer_morph.reproduction.planar.metrics import TIGHT_CLUSTER_RADIUS, PlanarMetrics, measure
from chamfer_morph.reproduction.planar.shapes import circle, even_star, star

Points = npt.NDArray[np.float64]

INK, FAINT = "#222222", "#6b727c"
COLORS = LinearSegmentedColormap.from_list("heaps", ("#2f78a8", "#7a4ea6", "#d12f6b", "#f26a1b"))
HEAP = LogNorm(1, 30)

_PANELS: dict[Setting, tuple[tuple[str, str], ...]] = {
    "paper": (
        ("dco", "each point for itself"),
        ("dco_repulsion", "repulsion, weight 2e-4"),
        ("fourier_clipped", "Fourier, clipped gradients"),
        ("fourier", "Fourier"),
    ),
    "converged": (
        ("dco", "each point for itself"),
        ("dco_repulsion", "repulsion, weight 2e-4"),
        ("dco_repulsion_tuned", "repulsion, weight 1e-7"),
        ("fourier", "Fourier"),
    ),
}
"""Experiments and their titles, a row a setting."""


def figure(runs: tuple[PlanarRun, ...]) -> Figure:
    """Start, ideal and end states of the strategies, in the paper's setting and at rest.

    A dot's colour and size tell how many points lie within .005 of it, so that a heap of thirty
    does not look like a single point. Lines show the way of every tenth point.

    Args:
        runs: From `run_all`.
    """
    config = PlanarConfig()
    target = star(config)
    by_name = {(each.experiment.name, each.experiment.setting): each for each in runs}
    picture = Figure(figsize=(13.0, 5.7), layout="constrained")
    axes = picture.subplots(2, 5)

    for panel, points, title in (
        (axes[0, 0], circle(config), "start"),
        (axes[1, 0], even_star(config, config.point_count), "ideal: an even spread"),
    ):
        _draw(panel, target, points[None])
        _describe(panel, title, measure(points, target))
    manners = "as in the paper", "brought to rest"
    for line, setting, manner in zip(axes, _PANELS, manners, strict=True):
        for panel, (name, title) in zip(line[1:], _PANELS[setting], strict=True):
            run = by_name[name, setting]
            _draw(panel, target, run.trajectory)
            _describe(panel, title, run.metrics)
        line[1].set_ylabel(f"{manner}\n{by_name['dco', setting].steps[-1]} steps", color=INK)

    bar = picture.colorbar(ScalarMappable(HEAP, COLORS), ax=axes, shrink=0.6, pad=0.01, aspect=30)
    bar.set_label(f"points within {TIGHT_CLUSTER_RADIUS:g} of this one, itself included")
    bar.set_ticks([1, 2, 3, 5, 10, 20, 30], labels=["1", "2", "3", "5", "10", "20", "30"])
    bar.ax.minorticks_off()
    bar.outline.set_visible(False)
    return picture


def _draw(panel: Axes, target: Points, trajectory: Points) -> None:
    """Target, ways and end state; the fullest heaps on top."""
    closed = np.vstack([target, target[:1]])
    panel.fill(*closed.T, facecolor="#eef0f3", edgecolor="#c9cdd3", linewidth=0.8, zorder=0)
    ways = np.moveaxis(trajectory[:, ::10], 0, 1)
    panel.add_collection(LineCollection(list(ways), colors="#b4bac4", linewidths=0.5, zorder=1))
    points = trajectory[-1]
    heap = cKDTree(points).query_ball_point(points, TIGHT_CLUSTER_RADIUS, return_length=True)
    order = np.argsort(heap, kind="stable")
    panel.scatter(
        points[order, 0],
        points[order, 1],
        c=heap[order],
        s=2.2 + 2.0 * (heap[order] - 1),
        cmap=COLORS,
        norm=HEAP,
        linewidths=0,
        zorder=2,
    )
    panel.set(xlim=(-1.12, 1.12), ylim=(-0.98, 1.08), aspect="equal", xticks=[], yticks=[])
    panel.spines[:].set_visible(False)


def _describe(panel: Axes, title: str, numbers: PlanarMetrics) -> None:
    panel.set_title(title, fontsize=10.5, color=INK, pad=4)
    panel.set_xlabel(
        f"CD {numbers.cd:.3f}   targets used {numbers.targets_used:.0%}"
        f"\ncoverage {numbers.coverage:.0%}   heaps {numbers.cluster_005:.0%}",
        fontsize=9,
        color=FAINT,
    )
