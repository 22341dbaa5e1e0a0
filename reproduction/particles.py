"""Particles as small lit spheres, drawn with NumPy alone."""

from __future__ import annotations

import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Array = NDArray[np.float64]

LIGHT = np.array([-0.4, 0.6, 0.7]) / np.linalg.norm([-0.4, 0.6, 0.7])


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
        view: Rotation from the domain to the eye, shape [3, 3], see `look`.
        pixels: Edge of one square panel.
        half_extent: What a panel shows, from its centre to its edge [dx].

    Returns:
        RGB image, shape [pixels, pixels * len(clouds), 3], 0 to 1.
    """
    return np.hstack(
        [_panel(cloud @ view.T, colors, radius, pixels, half_extent) for cloud in clouds]
    )


def look(*, azimuth: float, elevation: float, up: str) -> Array:
    """Rotation from the domain to an eye that looks along -z with y upwards.

    Args:
        azimuth: Turn about the upward axis [degrees].
        elevation: Height of the eye above the horizon [degrees].
        up: The domain's upward axis, "y" or "z".

    Returns:
        Orthogonal matrix, shape [3, 3].
    """
    ca, sa = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    ce, se = np.cos(np.radians(elevation)), np.sin(np.radians(elevation))
    turn = np.array([[ca, 0, -sa], [0, 1, 0], [sa, 0, ca]])
    tilt = np.array([[1, 0, 0], [0, ce, -se], [0, se, ce]])
    upright = np.eye(3)[[1, 2, 0]] if up == "z" else np.eye(3)
    view: Array = tilt @ turn @ upright
    return view


def _panel(seen: Array, colors: Array, radius: float, pixels: int, half_extent: float) -> Array:
    scale = pixels / (2 * half_extent)
    column, row = pixels / 2 + scale * seen[:, 0], pixels / 2 - scale * seen[:, 1]

    depth = np.full(pixels * pixels, -np.inf)
    owner = np.full(pixels * pixels, -1)
    normal = np.zeros((pixels * pixels, 3))
    nearest_last = np.argsort(seen[:, 2])  # so that the front particle paints over the others
    reach = int(np.ceil(radius * scale))
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            x = np.floor(column[nearest_last]).astype(int) + dx
            y = np.floor(row[nearest_last]).astype(int) + dy
            u = (x + 0.5 - column[nearest_last]) / (radius * scale)
            v = (row[nearest_last] - y - 0.5) / (radius * scale)
            inside = (u**2 + v**2 < 1) & (x >= 0) & (x < pixels) & (y >= 0) & (y < pixels)
            particle = nearest_last[inside]
            bulge = np.sqrt(1 - u[inside] ** 2 - v[inside] ** 2)
            pixel = y[inside] * pixels + x[inside]
            front = seen[particle, 2] + radius * bulge
            order = np.argsort(front)
            pixel, front, particle = pixel[order], front[order], particle[order]
            facing = np.column_stack([u[inside], v[inside], bulge])[order]
            last = np.unique(pixel[::-1], return_index=True)[1]
            chosen = len(pixel) - 1 - last
            wins = chosen[front[chosen] > depth[pixel[chosen]]]
            depth[pixel[wins]] = front[wins]
            owner[pixel[wins]] = particle[wins]
            normal[pixel[wins]] = facing[wins]

    image = np.ones((pixels * pixels, 3))
    hit = owner >= 0
    light = 0.45 + 0.55 * np.clip(normal[hit] @ LIGHT, 0, 1)
    shade = light * _openness(depth.reshape(pixels, pixels), scale).ravel()[hit]
    image[hit] = colors[owner[hit]] * shade[:, None]
    return np.clip(image, 0, 1).reshape(pixels, pixels, 3)


def _openness(depth: Array, scale: float) -> Array:
    """Darkens what lies deeper than its surroundings, which makes creases readable."""
    hit = np.isfinite(depth)
    filled = np.where(hit, depth, 0.0)
    weight = gaussian_filter(hit.astype(float), scale)
    around = gaussian_filter(filled, scale) / np.maximum(weight, 1e-6)
    openness: Array = np.clip(1 + 0.35 * (filled - around), 0.45, 1.25)
    return openness


def height_colors(source: Array, view: Array, *, palette: str = "turbo") -> Array:
    """A colour per particle by its height in the source, so that one sees where matter goes.

    Args:
        source: Positions [dx], shape [n, 3].
        view: Rotation from the domain to the eye, shape [3, 3].
        palette: A colour map of Matplotlib.

    Returns:
        RGB, shape [n, 3], 0 to 1.
    """
    height = source @ view[1]
    height = (height - height.min()) / np.ptp(height)
    colors: Array = np.asarray(matplotlib.colormaps[palette](0.1 + 0.8 * height))[:, :3]
    return colors
