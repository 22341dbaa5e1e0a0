"""Pictures of the planar experiment: the way, and the end with the heaps that points form."""

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
from chamfer_morph.reproduction.planar.experiment import PlanarTable, Setting
from chamfer_morph.reproduction.planar.metrics import (
    TIGHT_CLUSTER_RADIUS,
    PlanarMetrics,
    measure,
)
from chamfer_morph.reproduction.planar.shapes import star

Points = npt.NDArray[np.float64]

INK, FAINT = "#222222", "#6b727c"
COLORS = LinearSegmentedColormap.from_list("heaps", ("#2f78a8", "#7a4ea6", "#d12f6b", "#f26a1b"))
HEAP = LogNorm(1, 30)

_LINES: tuple[tuple[str, tuple[tuple[str, Setting, str], ...]], ...] = (
    (
        "as in the paper",
        (
            ("start", "reference", "start"),
            ("dco", "paper", "each point for itself"),
            ("dco_repulsion", "paper", "repulsion, weight 2e-4"),
            ("fourier_clipped", "paper", "Fourier, clipped gradients"),
            ("fourier", "paper", "Fourier"),
        ),
    ),
    (
        "brought to rest",
        (
            ("even_spread", "reference", "ideal: an even spread"),
            ("dco", "converged", "each point for itself"),
            ("dco_repulsion", "converged", "repulsion, weight 2e-4"),
            ("dco_repulsion_tuned", "converged", "repulsion, weight 1e-7"),
            ("fourier", "converged", "Fourier"),
        ),
    ),
)
"""The panels by line: row of the table, title."""


def figure(table: PlanarTable) -> Figure:
    """Start, ideal and end states of the strategies, in the paper's setting and at rest.

    A dot's colour and size tell how many points lie within .005 of it, so that a heap of thirty
    does not look like a single point. Lines show the way of every tenth point.
    """
    target = star(PlanarConfig().target_count)
    picture = Figure(figsize=(13.0, 5.7), layout="constrained")
    axes = picture.subplots(2, 5)
    for line, (manner, panels) in zip(axes, _LINES, strict=True):
        for panel, (name, setting, title) in zip(line, panels, strict=True):
            row = table[name, setting]
            _draw(panel, target, row.trajectory)
            _describe(panel, title, row.metrics)
        line[1].set_ylabel(f"{manner}\n{table['dco', panels[1][1]].steps} steps", color=INK)

    bar = picture.colorbar(ScalarMappable(HEAP, COLORS), ax=axes, shrink=0.6, pad=0.01, aspect=30)
    bar.set_label(f"points within {TIGHT_CLUSTER_RADIUS:g} of this one, itself included")
    bar.set_ticks([1, 2, 3, 5, 10, 20, 30], labels=["1", "2", "3", "5", "10", "20", "30"])
    bar.ax.minorticks_off()
    bar.outline.set_visible(False)
    return picture


_STRATEGIES = (
    ("dco", "each point for itself"),
    ("dco_repulsion_vector", "local repulsion"),
    ("fourier", "shared basis"),
)
"""The rows of the paper's figure: row of the table, name."""


def stages(table: PlanarTable) -> Figure:
    """Initial, mid and final steps of the paper's setting, and the distance over the steps.

    The layout of the paper's figure 3: a row per strategy. Dots have the colours of `figure`.
    """
    target = star(PlanarConfig().target_count)
    picture = Figure(figsize=(11.0, 7.6), layout="constrained")
    axes = picture.subplots(len(_STRATEGIES), 4)
    for line, (name, title) in zip(axes, _STRATEGIES, strict=True):
        row = table[name, "paper"]
        last = len(row.trajectory) - 1
        steps = np.linspace(0, row.steps, last + 1).round()
        distance = [measure(points, target).cd for points in row.trajectory]
        for panel, place in zip(line, (0, last // 2, last), strict=False):
            _draw(panel, target, row.trajectory[: place + 1])
            panel.set_title(f"step {steps[place]:.0f}", fontsize=10.5, color=INK, pad=4)
            panel.set_xlabel(f"CD {distance[place]:.3f}", fontsize=9, color=FAINT)
        line[0].set_ylabel(title, color=INK)
        line[3].plot(steps, distance, color=INK, linewidth=1.4)
        line[3].set(xlabel="step", ylabel="two-sided CD", ylim=(0, 0.4), xlim=(0, row.steps))
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
