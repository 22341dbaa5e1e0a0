"""Figures made of particles: final shapes, film strips, cross-sections, densities."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from chamfer_morph.reproduction.report.charts import BLACK, VERMILION, style
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.store import Store
from morph_engine.metrics.volume import density_ratio
from morph_engine.rendering.pictures import (
    PARTICLE_RADIUS_OVER_H,
    Camera,
    height_colors,
    look,
    picture,
)

Array = NDArray[np.float64]

PANEL_PIXELS = 360
MARGIN_PIXELS = 8
TITLE_CHARACTERS = 22
PANEL_HALF_EXTENT = 13.5
"""What a panel shows, from its centre to its edge [dx]."""

PALETTE = "viridis"
TARGET_GREY = 0.72
UPRIGHT = look(azimuth=20.0, elevation=15.0, up="z")
"""The paper's meshes stand on their feet with z upwards."""

DRAGON = "dragon.obj"
DRAGON_VIEW = look(azimuth=-70.0, elevation=15.0, up="y")

OVERLAP_DISTANCE = 0.01
"""Particles closer than this coincide, as in the paper's trajectory figure [dx]."""


@dataclass(frozen=True)
class PointCloud:
    """Particles to be shown.

    Attributes:
        title: What they are.
        points: Positions [dx], shape [n, 3].
        colors: RGB, shape [n, 3].
        spacing: Lattice spacing h [dx].
        view: Rotation from the domain to the eye, shape [3, 3].
    """

    title: str
    points: Array
    colors: Array
    spacing: float
    view: Array


def final_cloud(store: Store, run: Run, title: str, *, frame: int = -1) -> PointCloud:
    """A frame of a run, coloured by height in the source.

    Raises:
        ResultError: The result file is absent or damaged.
    """
    with store.trajectory(run) as result:
        source = result.run.source_points.astype(np.float64)
        points = result.positions(frame).astype(np.float64)
    return _cloud(run, title, points, height_colors(source, view_of(run), palette=PALETTE))


def target_cloud(store: Store, run: Run, title: str = "target") -> PointCloud:
    """What a run aims at, in grey.

    Raises:
        ResultError: The result file is absent or damaged.
    """
    with store.trajectory(run) as result:
        points = result.target_points.astype(np.float64)
    return _cloud(run, title, points, np.full_like(points, TARGET_GREY))


def source_cloud(store: Store, run: Run, title: str = "source") -> PointCloud:
    """Where a run begins.

    Raises:
        ResultError: The result file is absent or damaged.
    """
    with store.trajectory(run) as result:
        points = result.run.source_points.astype(np.float64)
    return _cloud(run, title, points, height_colors(points, view_of(run), palette=PALETTE))


def _cloud(run: Run, title: str, points: Array, colors: Array) -> PointCloud:
    return PointCloud(title, points, colors, 1 / run.points_per_cell_edge, view_of(run))


def view_of(run: Run) -> Array:
    """The side from which a run's shapes are looked at, shape [3, 3]."""
    return DRAGON_VIEW if DRAGON in run.shapes else UPRIGHT


def gallery(rows: Sequence[tuple[str, Sequence[PointCloud | None]]]) -> Figure:
    """Clouds in rows, each row centred on its first cloud.

    Args:
        rows: Name and clouds of each row, the first of which is there; None leaves a place empty.
            The titles of the first row stand above its columns.
    """
    columns = max(len(clouds) for _, clouds in rows)
    images = [_panels(clouds) for _, clouds in rows]
    heights = [row[0].shape[0] / row[0].shape[1] for row in images if row[0] is not None]
    width = min(7.2, 1.9 * columns)
    with style():
        figure = Figure(
            figsize=(width, width / columns * sum(heights) + 0.25), layout="constrained"
        )
        grid = figure.subplots(
            len(rows), columns, squeeze=False, gridspec_kw={"height_ratios": heights}
        )
        for index, (name, clouds) in enumerate(rows):
            for axes in grid[index]:
                _bare(axes)
            for axes, cloud, image in zip(grid[index], clouds, images[index], strict=False):
                if cloud is None or image is None:
                    continue
                axes.imshow(image, interpolation="antialiased")
                if index == 0:
                    axes.set_title(cloud.title)
            grid[index][0].set_ylabel(name)
    return figure


def _panels(clouds: Sequence[PointCloud | None]) -> list[Array | None]:
    """Pictures of a row of clouds, with no more height than they need."""
    first = clouds[0]
    assert first is not None
    centre = (first.points.min(axis=0) + first.points.max(axis=0)) / 2
    images = [None if cloud is None else _panel(cloud, centre) for cloud in clouds]
    used = np.any([(image < 1).any(axis=(1, 2)) for image in images if image is not None], axis=0)
    top, bottom = np.flatnonzero(used)[[0, -1]]
    kept = slice(max(0, top - MARGIN_PIXELS), bottom + MARGIN_PIXELS + 1)
    return [None if image is None else image[kept] for image in images]


def _panel(cloud: PointCloud, centre: Array) -> Array:
    image = picture(
        cloud.points - centre,
        spacing=0.6 * cloud.spacing / PARTICLE_RADIUS_OVER_H,
        colors=cloud.colors,
        view=Camera(cloud.view, np.zeros(3), PANEL_HALF_EXTENT),
        size=(PANEL_PIXELS, PANEL_PIXELS),
    )
    return image / 255


def cross_sections(clouds: Sequence[PointCloud], *, thickness: float = 0.5) -> Figure:
    """Slices through the middle; particles that coincide with another are marked.

    Args:
        clouds: What to cut, across x at the median of the first one.
        thickness: Of the slice [dx].
    """
    middle = np.median(clouds[0].points[:, 0])
    with style():
        figure = Figure(figsize=(7.2, 6.0 / len(clouds) + 0.5), layout="constrained")
        panels = figure.subplots(1, len(clouds), sharex=True, sharey=True, squeeze=False)[0]
        for axes, cloud in zip(panels, clouds, strict=True):
            gap, _ = cKDTree(cloud.points).query(cloud.points, k=2)
            close = gap[:, 1] < OVERLAP_DISTANCE
            cut = np.abs(cloud.points[:, 0] - middle) < thickness / 2
            for chosen, color in ((cut & ~close, BLACK), (cut & close, VERMILION)):
                _, y, z = cloud.points[chosen].T
                axes.scatter(y, z, s=1.6, color=color, linewidths=0, rasterized=True)
            axes.set(aspect="equal", title=f"{cloud.title}\n{close.mean():.1%} overlap")
            _bare(axes)
    return figure


def densities(
    clouds: Sequence[PointCloud], target: PointCloud, *, thickness: float = 0.5, columns: int = 4
) -> Figure:
    """Density ratio at the target points of a slice through the middle: 1 is an even fill.

    Args:
        clouds: Particles of each result.
        target: The target's points.
        thickness: Of the slice [dx].
        columns: Panels in a row.
    """
    across = target.points[:, 0]
    cut = np.abs(across - np.median(across)) < thickness / 2
    shown = target.points[cut]
    norm = LogNorm(0.25, 4.0)
    row_count = -(-len(clouds) // columns)
    with style():
        figure = Figure(figsize=(7.2, 1.6 * row_count + 0.4), layout="constrained")
        panels = figure.subplots(row_count, columns, sharex=True, sharey=True, squeeze=False)
        for axes in panels.ravel():
            _bare(axes)
        for axes, cloud in zip(panels.ravel(), clouds, strict=False):
            ratio = density_ratio(cloud.points, target.points)[cut]
            axes.scatter(
                shown[:, 1],
                shown[:, 2],
                c=np.clip(ratio, 0.25, 4.0),
                cmap="PuOr_r",
                norm=norm,
                s=3,
                edgecolors="#BBBBBB",
                linewidths=0.15,
                rasterized=True,
            )
            axes.set(aspect="equal", title=_wrapped(cloud.title))
        bar = figure.colorbar(
            ScalarMappable(norm, "PuOr_r"),
            ax=panels,
            shrink=0.8,
            ticks=[0.25, 0.5, 1, 2, 4],
            label="density over an even fill's",
        )
        bar.ax.set_yticklabels(["≤ ¼", "½", "1", "2", "≥ 4"])
        bar.ax.minorticks_off()
    return figure


def _bare(axes: Axes) -> None:
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _wrapped(title: str) -> str:
    """A title in lines no wider than a panel."""
    return "\n".join(textwrap.fill(line, TITLE_CHARACTERS) for line in title.splitlines())
