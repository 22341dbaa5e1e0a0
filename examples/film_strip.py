"""Draw frames of a result side by side, as in the README's picture.

    python examples/film_strip.py sphere-to-bunny.vtkhdf docs/images/morph.png --frames 0 4 8 39

Each particle is a small lit sphere and keeps the colour of its height in the source, so that one
sees where matter goes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from morph_engine.rendering.pictures import (
    PARTICLE_RADIUS_OVER_H,
    Camera,
    height_colors,
    look,
    picture,
)
from morph_engine.results.trajectory import Trajectory

PANEL_PIXELS = 420
HALF_EXTENT = 12.0
"""What a panel shows, from its centre to its edge [dx]."""


def main() -> None:
    """Read the command line and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("result", help="a .vtkhdf file")
    parser.add_argument("picture", type=Path, help="the .png file to write")
    parser.add_argument("--frames", type=int, nargs="+", default=[0, -1])
    parser.add_argument("--up", choices=("y", "z"), default="y", help="the upward axis")
    parser.add_argument("--azimuth", type=float, default=25.0, help="in degrees")
    parser.add_argument("--elevation", type=float, default=15.0, help="in degrees")
    arguments = parser.parse_args()

    with Trajectory(arguments.result) as result:
        source = result.run.source_points.astype(np.float64)
        target = result.target_points.astype(np.float64)
        frames = [result.positions(index).astype(np.float64) for index in arguments.frames]
    view = look(azimuth=arguments.azimuth, elevation=arguments.elevation, up=arguments.up)
    colors = height_colors(source, view)
    spacing = (np.prod(np.ptp(target, axis=0)) / len(target)) ** (1 / 3)
    centre = (target.min(axis=0) + target.max(axis=0)) / 2
    panels = [
        picture(
            cloud - centre,
            spacing=0.55 * spacing / PARTICLE_RADIUS_OVER_H,
            colors=colors,
            view=Camera(view, np.zeros(3), HALF_EXTENT),
            size=(PANEL_PIXELS, PANEL_PIXELS),
        )
        for cloud in (source, *frames)
    ]
    assert all((panel < 255).any() for panel in panels), "Every panel should show particles."
    arguments.picture.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.hstack(panels)).save(arguments.picture)


if __name__ == "__main__":
    main()
