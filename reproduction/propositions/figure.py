"""The picture of the propositions: a column each, the scene above and its measurement below."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from scipy.spatial import Voronoi

from chamfer_morph.reproduction.propositions.collapse import RATE, STEPS, descend
from chamfer_morph.reproduction.propositions.coupling import (
    WIDE,
    basis,
    coupled_descent,
    grid,
    independent,
)
from chamfer_morph.reproduction.propositions.drift import (
    adam_displacement,
    crossing_drift,
    drift,
    one_sided_drift,
    penalty_force,
)
from chamfer_morph.reproduction.propositions.scene import (
    CENTER,
    TARGETS,
    cluster,
    reverse_gradient,
    spread,
)
from chamfer_morph.reproduction.propositions.separation import COUNT, apart, moving

Points = npt.NDArray[np.float64]

INK, FAINT = "#222222", "#8d939c"
BLUE, ORANGE, GREEN, PURPLE = "#2f78a8", "#e2711d", "#3a8f5c", "#7a4ea6"


def figure() -> Figure:
    """Four columns: propositions 1 to 3 and corollary 1."""
    layout = ConstrainedLayoutEngine(w_pad=0.12, hspace=0.04)
    picture = Figure(figsize=(14.0, 6.6), layout=layout)
    axes = picture.subplots(2, 4, height_ratios=(1.05, 1))
    for panel, draw in zip(
        axes.flat,
        (
            _collapse_scene, _separation_scene, _drift_scene, _coupling_scene,
            _collapse_rate, _separation_count, _drift_ratio, _coupling_spread,
        ),
        strict=True,
    ):  # fmt: skip
        draw(panel)
    for panel in axes[1]:
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=9)
    return picture


def _collapse_scene(panel: Axes) -> None:
    _cells(panel, "Proposition 1\none cell, one attractor")
    way = np.moveaxis(descend(cluster(), STEPS), 0, 1)
    panel.add_collection(LineCollection(list(way), colors=BLUE, linewidths=1.0, alpha=0.7))
    panel.plot(*cluster().T, "o", markersize=4, color=BLUE, zorder=3)
    panel.set(xlim=(-0.62, 0.62), ylim=(-0.56, 0.56))


def _collapse_rate(panel: Axes) -> None:
    distance = np.linalg.norm(descend(cluster(), STEPS) - CENTER, axis=-1)
    panel.semilogy(distance, color=BLUE, linewidth=0.9, alpha=0.7)
    law = 3 * distance.max() * (1 - RATE) ** np.arange(STEPS + 1)
    panel.semilogy(law, color=INK, linewidth=1.2, linestyle=(0, (4, 3)))
    panel.annotate("(1 − 2η/N)ᵗ", (100, law[100]), (8, 4), textcoords="offset points", color=INK)
    panel.set(xlabel="step", ylabel="distance of each point to q*", xlim=(0, STEPS))


def _separation_scene(panel: Axes) -> None:
    _cells(panel, "Proposition 2\ncoincident points share one pull")
    panel.set(xlim=(-1.5, 1.5), ylim=(-1.35, 1.35))
    for points, color in ((apart(0.3), ORANGE), (np.tile(CENTER, (COUNT, 1)), BLUE)):
        pull = -reverse_gradient(points)
        strong = np.linalg.norm(pull, axis=1) > 0
        panel.plot(*points.T, "o", markersize=4, color=color, zorder=3)
        panel.quiver(
            *points[strong].T, *(1.8 * pull[strong]).T, color=color, zorder=6,
            angles="xy", scale_units="xy", scale=1, width=0.009,
        )  # fmt: skip
    _name(panel, (("coincident", BLUE), ("apart", ORANGE)))


def _separation_count(panel: Axes) -> None:
    distance = np.logspace(-12, -1, 23)
    count = [int(moving(apart(each)).sum()) for each in distance]
    panel.semilogx(distance, count, "o", color=ORANGE, markersize=4)
    together = moving(np.tile(CENTER, (COUNT, 1))).sum()
    panel.plot([1e-14], [together], "o", color=BLUE, markersize=6)
    panel.annotate("coincident", (1e-14, together), (9, -3), textcoords="offset points", color=BLUE)
    panel.annotate(
        "any distance apart", (1e-8, max(count)), (0, 8), textcoords="offset points", color=ORANGE
    )
    panel.set(
        xlabel="distance of the points from q*",
        ylabel=f"points of {COUNT} with a reverse gradient",
        ylim=(0, COUNT * 0.7),
        xlim=(2e-15, 0.3),
    )
    panel.set_xticks([1e-14, 1e-11, 1e-8, 1e-5, 1e-2], labels=["0", "1e-11", "1e-8", "1e-5", ".01"])
    panel.minorticks_off()


def _drift_scene(panel: Axes) -> None:
    _cells(panel, "Proposition 3\nforces within a cluster cancel")
    points = cluster()
    force = penalty_force("repulsion", points, 1.0)
    force /= np.linalg.norm(force, axis=1, keepdims=True) ** 0.75  # so that all can be seen
    force *= 0.22 / np.linalg.norm(force, axis=1).max()
    panel.plot(*points.T, "o", markersize=4, color=BLUE, zorder=3)
    panel.quiver(
        *points.T, *force.T, color=ORANGE, angles="xy", scale_units="xy", scale=1, width=0.008
    )
    centroid = points.mean(axis=0)
    panel.annotate(
        "",
        (0, 0),
        (centroid[0], centroid[1]),
        arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 1.6},
    )
    panel.plot(*centroid, "s", color=INK, markersize=5)
    panel.set(xlim=(-0.62, 0.62), ylim=(-0.56, 0.56))
    _name(panel, (("repulsion (lengths compressed)", ORANGE), ("drift of the centroid", INK)))


def _drift_ratio(panel: Axes) -> None:
    weight = np.logspace(-6, -1, 16)
    inside = [drift(cluster(), penalty_force("repulsion", cluster(), each)) for each in weight]
    adam = [adam_displacement(each) / adam_displacement(0.0) for each in weight]
    lines = (
        (inside, BLUE, "lists inside the cluster"),
        ([crossing_drift(each) for each in weight], ORANGE, "lists across cells"),
        ([one_sided_drift(each) for each in weight], GREEN, "one-sided force"),
        (adam, PURPLE, "Adam"),
    )
    for ratio, color, label in lines:
        panel.semilogx(weight, ratio, color=color, linewidth=1.6, label=label)
    panel.set(
        xlabel="weight of the repulsion", ylabel="drift of the centroid / (2η/N)", ylim=(0, 3)
    )
    panel.legend(frameon=False, fontsize=9, loc="upper left", labelcolor="linecolor")


def _coupling_scene(panel: Axes) -> None:
    _cells(panel, "Corollary 1\nshared fields carry a cluster whole")
    for coupling, color in ((basis, ORANGE), (independent, BLUE)):
        way = np.moveaxis(coupled_descent(coupling), 0, 1)
        panel.add_collection(LineCollection(list(way), colors=color, linewidths=1.2, alpha=0.8))
        panel.plot(*way[:, -1].T, "o", markersize=4, color=color, zorder=4)
    panel.plot(*cluster().T, "o", markersize=4, color=FAINT, markerfacecolor="white", zorder=3)
    panel.set(xlim=(-0.62, 0.62), ylim=(-0.56, 0.56))
    _name(panel, (("independent points", BLUE), ("shared basis", ORANGE)))


def _coupling_spread(panel: Axes) -> None:
    for coupling, color, label in (
        (grid(WIDE), GREEN, "grid"),
        (basis, ORANGE, "shared basis"),
        (independent, BLUE, "independent points"),
    ):
        way = coupled_descent(coupling)
        share = [spread(each) / spread(way[0]) for each in way]
        panel.semilogy(share, color=color, linewidth=1.6, label=label)
    panel.set(xlabel="step", ylabel="spread of the cluster / its first", ylim=(4e-3, 1.6))
    panel.legend(frameon=False, fontsize=9, loc="lower left", labelcolor="linecolor")


def _name(panel: Axes, names: tuple[tuple[str, str], ...]) -> None:
    """What the colours mean, in the lower left corner, the first on top."""
    for line, (label, color) in enumerate(reversed(names)):
        panel.annotate(
            label, (0, 0), (6, 6 + 13 * line), xycoords="axes fraction",
            textcoords="offset points", color=color, fontsize=9, zorder=7,
        )  # fmt: skip


def _cells(panel: Axes, title: str) -> None:
    """The targets with their Voronoi cells; q* is the one amid the others."""
    far = 50 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    cells = Voronoi(np.vstack([TARGETS, far]))
    own = cells.regions[cells.point_region[0]]
    panel.fill(*cells.vertices[own].T, color="#eef0f3", zorder=0)
    edges = [cells.vertices[ridge] for ridge in cells.ridge_vertices if -1 not in ridge]
    panel.add_collection(LineCollection(edges, colors="#c9cdd3", linewidths=0.8, zorder=1))
    panel.plot(*TARGETS[1:].T, "x", color=INK, markersize=6)
    panel.plot(*CENTER, "*", color=INK, markersize=13, zorder=5)
    panel.set_title(title, fontsize=11, color=INK)
    panel.set(aspect="equal", xticks=[], yticks=[])
    panel.spines[:].set_color("#c9cdd3")
