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

COLUMNS = 4
"""Panels in a row of densities."""

SLICE_THICKNESS = 0.5
"""Of cross-sections and densities [dx]."""

PALETTE = "viridis"
TARGET_GREY = 0.72
UPRIGHT = look(azimuth=110.0, elevation=15.0, up="z")
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
        run: Whose they are.
        points: Positions [dx], shape [n, 3].
        colors: RGB, shape [n, 3].
    """

    title: str
    run: Run
    points: Array
    colors: Array


def frame_cloud(store: Store, run: Run, title: str, frame: int | None = -1) -> PointCloud:
    """A frame of a run, or its source for None, coloured by height in the source.

    Raises:
        ResultError: The result file is absent or damaged.
    """
    with store.trajectory(run) as result:
        source = points = result.run.source_points.astype(np.float64)
        if frame is not None:
            points = result.positions(frame).astype(np.float64)
    return PointCloud(title, run, points, height_colors(source, view_of(run), palette=PALETTE))


def target_cloud(store: Store, run: Run) -> PointCloud:
    """What a run aims at, in grey.

    Raises:
        ResultError: The result file is absent or damaged.
    """
    with store.trajectory(run) as result:
        points = result.target_points.astype(np.float64)
    return PointCloud("target", run, points, np.full_like(points, TARGET_GREY))


def view_of(run: Run) -> Array:
    """The side from which a run's shapes are looked at, shape [3, 3]."""
    return DRAGON_VIEW if DRAGON in run.shapes else UPRIGHT


def gallery(rows: Sequence[tuple[str, Sequence[PointCloud | None]]]) -> Figure:
    """Clouds in rows, each row centred on its first cloud.

    Args:
        rows: Name and clouds of each row, the first of which is there; None leaves a place empty.
            A title stands above its cloud unless it is that of the row above.
    """
    columns = max(len(clouds) for _, clouds in rows)
    images = [_panels(clouds) for _, clouds in rows]
    heights = [len(row[0]) / PANEL_PIXELS for row in images]
    width = min(7.2, 1.9 * columns)
    size = (width, width / columns * sum(heights) + 0.25)
    above: dict[int, str] = {}
    with style():
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(len(rows), columns, squeeze=False, height_ratios=heights)
        for panels, (name, clouds), row in zip(grid, rows, images, strict=True):
            for axes in panels:
                _bare(axes)
            for column, (axes, cloud, image) in enumerate(zip(panels, clouds, row, strict=False)):
                if cloud:
                    axes.imshow(image, interpolation="antialiased")
                    if above.get(column) != cloud.title:
                        axes.set_title(cloud.title)
                    above[column] = cloud.title
            panels[0].set_ylabel(name.replace(", ", "\n"))
    return figure


def _panels(clouds: Sequence[PointCloud | None]) -> list[Array]:
    """Pictures of a row of clouds, with no more height than they need."""
    first = clouds[0]
    assert first is not None
    centre = (first.points.min(axis=0) + first.points.max(axis=0)) / 2
    images = [_panel(cloud or first, centre) for cloud in clouds]
    used = np.any([(image < 1).any(axis=(1, 2)) for image in images], axis=0)
    top, bottom = np.flatnonzero(used)[[0, -1]]
    kept = slice(max(0, top - MARGIN_PIXELS), bottom + MARGIN_PIXELS + 1)
    return [image[kept] for image in images]


def _panel(cloud: PointCloud, centre: Array) -> Array:
    image = picture(
        cloud.points - centre,
        spacing=0.6 * (1 / cloud.run.points_per_cell_edge) / PARTICLE_RADIUS_OVER_H,
        colors=cloud.colors,
        view=Camera(view_of(cloud.run), np.zeros(3), PANEL_HALF_EXTENT),
        size=(PANEL_PIXELS, PANEL_PIXELS),
    )
    return image / 255


def cross_sections(clouds: Sequence[PointCloud]) -> Figure:
    """Slices across x at the median of the first cloud; coincident particles are marked."""
    middle = np.median(clouds[0].points[:, 0])
    with style():
        figure = Figure(figsize=(7.2, 6.0 / len(clouds) + 0.5), layout="constrained")
        panels = figure.subplots(1, len(clouds), sharex=True, sharey=True, squeeze=False)[0]
        for axes, cloud in zip(panels, clouds, strict=True):
            gap, _ = cKDTree(cloud.points).query(cloud.points, k=2)
            close = gap[:, 1] < OVERLAP_DISTANCE
            cut = np.abs(cloud.points[:, 0] - middle) < SLICE_THICKNESS / 2
            for chosen, color in ((cut & ~close, BLACK), (cut & close, VERMILION)):
                _, y, z = cloud.points[chosen].T
                axes.scatter(y, z, s=1.6, color=color, linewidths=0, rasterized=True)
            axes.set(aspect="equal", title=f"{cloud.title}\n{close.mean():.1%} overlap")
            _bare(axes)
    return figure


def densities(clouds: Sequence[PointCloud], target: PointCloud) -> Figure:
    """Density ratio at the target points of a slice through the middle: 1 is an even fill."""
    across = target.points[:, 0]
    cut = np.abs(across - np.median(across)) < SLICE_THICKNESS / 2
    _, y, z = target.points[cut].T
    colors = ScalarMappable(LogNorm(0.25, 4.0), "PuOr_r")
    row_count = -(-len(clouds) // COLUMNS)
    columns = -(-len(clouds) // row_count)  # as many in each row as may be
    with style():
        height = 1.6 * COLUMNS / columns * row_count + 0.4
        figure = Figure(figsize=(7.2, height), layout="constrained")
        panels = figure.subplots(row_count, columns, sharex=True, sharey=True, squeeze=False)
        for axes in panels.ravel():
            _bare(axes)
        for axes, cloud in zip(panels.ravel(), clouds, strict=False):
            ratio = density_ratio(cloud.points, target.points)[cut]
            fill = colors.to_rgba(np.clip(ratio, 0.25, 4.0))
            axes.scatter(y, z, 3, fill, edgecolors="#BBBBBB", linewidths=0.15, rasterized=True)
            axes.set(aspect="equal", title=textwrap.fill(cloud.title, TITLE_CHARACTERS))
        bar = figure.colorbar(
            colors,
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
    axes.spines[:].set_visible(False)
