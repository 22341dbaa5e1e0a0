"""A gallery: twelve morphs by the default method, a sheet of their surfaces and a video of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from morph_engine.morphing import morph
from morph_engine.presets import configure
from morph_engine.rendering.pictures import Camera, height_colors, look, picture, video
from morph_engine.results.selection import Selection
from morph_engine.results.trajectory import Trajectory

MORPHS = (
    ("sphere", "heart", "fast"),
    ("heart", "star", "fast"),
    ("star", "torus", "fast"),
    ("torus", "teapot", "fast"),
    ("teapot", "sphere", "fast"),
    ("torus", "star", "fast"),
    ("text:A", "text:B", "fast"),
    ("teapot", "heart", "fast"),
    ("heart", "torus", "stiff"),
    ("heart", "torus", "soft"),
    ("heart", "torus", "viscous"),
    ("heart", "torus", "fluid"),
)
"""Source, target and preset; every shape is built in."""

SHOWN = (0, 8, 14, 20, 26, 39)
"""Frames of the sheet."""

SIZE = (240, 200)
QUALITY = 85
VIEW = look(azimuth=30.0, elevation=20.0)


def gallery(folder: Path) -> None:
    """Compute the morphs, draw `gallery.webp` and write `SOURCE-TARGET-PRESET.gif` for each.

    Results are kept beside them; those that are there as a whole are not computed again.
    """
    rows = []
    for source, target, preset in MORPHS:
        name = f"{source}-{target}-{preset}".replace(":", "_")
        result = folder / f"{name}.vtkhdf"
        if not _is_complete(result):
            config = configure(preset, {"sampling.fit": "volume"})
            for frame in morph(source, target, config, out=result, overwrite=True):
                print(f"{name}: frame {frame.index}", end="\r", flush=True)
        print(f"{name}: pictures    ")
        rows.append(row_of_surfaces(result, f"{source} to {target}, {preset}"))
        video(result, folder / f"{name}.gif", surface=True, size=(480, 360))
    Image.fromarray(np.concatenate(rows)).save(folder / "gallery.webp", quality=QUALITY)


def _is_complete(result: Path) -> bool:
    if not result.exists():
        return False
    with Trajectory(result) as trajectory:
        return trajectory.status == "complete"


def row_of_surfaces(result: Path, title: str) -> np.ndarray:
    """Surfaces of some frames beside each other; colours stay with the matter."""
    with Trajectory(result) as trajectory:
        selection = Selection(trajectory, SHOWN, surface=True, units="grid")
        particles = [trajectory.positions(frame) for frame in SHOWN]
        colors = height_colors(particles[0], VIEW)
        view = Camera.facing(np.concatenate(particles), VIEW, SIZE)
        panels = [
            picture(
                shown.vertices,
                spacing=shown.spacing,
                faces=shown.faces,
                colors=colors[cKDTree(points).query(shown.vertices)[1]],
                view=view,
                size=SIZE,
            )
            for points, shown in zip(particles, selection.snapshots(), strict=True)
        ]
    row = Image.fromarray(np.concatenate(panels, axis=1))
    ImageDraw.Draw(row).text((6, 4), title, fill="black")
    return np.asarray(row)
