"""Particles as small lit spheres, cloud beside cloud."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morph_engine.rendering.pictures import PARTICLE_RADIUS_OVER_H, Camera, picture

Array = NDArray[np.float64]


def film_strip(
    clouds: list[Array],
    colors: Array,
    *,
    radius: float,
    view: Array,
    pixels: int = 420,
    half_extent: float = 12.0,
) -> Array:
    """Render point clouds side by side.

    Args:
        clouds: Positions [dx], each of shape [n, 3].
        colors: One colour per particle, shape [n, 3], 0 to 1.
        radius: Radius of a particle [dx].
        view: Rotation from the domain to the eye, shape [3, 3], see `rendering.pictures.look`.
        pixels: Edge of one square panel.
        half_extent: What a panel shows, from its centre to its edge [dx].

    Returns:
        RGB image, shape [pixels, pixels * len(clouds), 3], 0 to 1.
    """
    panels = [
        picture(
            cloud,
            spacing=radius / PARTICLE_RADIUS_OVER_H,
            colors=colors,
            view=Camera(view, np.zeros(3), half_extent),
            size=(pixels, pixels),
        )
        for cloud in clouds
    ]
    strip: Array = np.hstack(panels) / 255
    return strip
