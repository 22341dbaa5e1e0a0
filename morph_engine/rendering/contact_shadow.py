"""A soft shadow on the ground, darkest where something touches it, as in the page.

What an eye below the ground sees, the darker the nearer it is to the ground, and blurred.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, map_coordinates

from morph_engine.geometry.point_cloud import ball_around
from morph_engine.geometry.upward import Up
from morph_engine.rendering.rasterizer import Canvas

Floats = npt.NDArray[np.floating]

PIXELS = 256
REACH = 3.0
"""Edge of the ground over the radius of what stands on it."""

HIGHEST = 2.0
"""What is so many radii above the ground casts no shadow."""

BLUR = 5.0
"""Standard deviation of the blur [pixels]."""

DARKEST = 0.5
"""How far the shadow hides the background where something touches the ground."""

LEAST_SLOPE = 1e-3
"""Sine of the angle from which the ground is seen; flatter than this it is not."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A level plane.

    Attributes:
        up: The axis that points upwards.
        centre: Of what stands on it [dx], shape [3].
        radius: Of a ball around all of that [dx].
        level: Where the plane crosses the upward axis [dx].
    """

    up: Up
    centre: Floats
    radius: float
    level: float

    @classmethod
    def below(cls, points: npt.ArrayLike, up: Up) -> Ground:
        """The ground that the lowest of some points, shape [n, 3] [dx], stands on."""
        array = np.asarray(points, np.float64)
        centre, radius = ball_around(array)
        return cls(up, centre, max(radius, 1e-6), _lowest(array, up))

    def touched_by(self, points: npt.ArrayLike) -> Ground:
        """The same ground, moved up or down to the lowest of other points, shape [n, 3] [dx]."""
        return replace(self, level=_lowest(np.asarray(points, np.float64), self.up))

    def under(self, points: npt.ArrayLike) -> Floats:
        """Where points would touch the ground, straight below them, shape [n, 3]."""
        feet = np.array(points, np.float64)
        feet[:, "xyz".index(self.up)] = self.level
        return feet

    def shadow(
        self, points: Floats, radius: float, faces: npt.NDArray[np.int32] | None
    ) -> npt.NDArray[np.float32]:
        """The shadow of particles or of a surface.

        Args:
            points: Particles, or corners of the surface [dx], shape [n, 3].
            radius: Of a particle [dx].
            faces: Triangles of the surface, shape [f, 3]; None for particles.

        Returns:
            How far each place of the ground is hidden, 0 to 1, shape [PIXELS, PIXELS], float32;
            columns along the first axis of `_axes`, rows against the second.
        """
        scale = PIXELS / (REACH * self.radius)
        apart = (points[np.isfinite(points).all(axis=1)] if faces is None else points) - self.centre
        seen = (apart @ self._axes().T * scale).astype(np.float32)
        blank = np.zeros_like(seen)
        canvas = Canvas(PIXELS, PIXELS)
        if faces is None:
            canvas.spheres(seen, max(radius * scale, 1.0), blank)
        else:
            canvas.triangles(seen, blank, blank, faces)
        up = "xyz".index(self.up)
        height = (self.centre[up] - self.level - canvas.depth / scale) / (HIGHEST * self.radius)
        dark = np.where(canvas.covered, (1 - height.clip(0, 1)) ** 3, 0)
        blurred: npt.NDArray[np.float32] = gaussian_filter(dark, BLUR, mode="constant")
        return (DARKEST * blurred).astype(np.float32)

    def seen(
        self, shadow: Floats, rotation: Floats, centre: Floats, pixel: float, size: tuple[int, int]
    ) -> npt.NDArray[np.float32]:
        """The shadow in a picture.

        Args:
            shadow: As by `shadow`.
            rotation: From the domain to an eye infinitely far away, shape [3, 3].
            centre: What the middle of the picture shows [dx], shape [3].
            pixel: Edge of a pixel [dx].
            size: Width and height [pixels].

        Returns:
            How far it hides the background, shape [height, width], float32.
        """
        width, height = size
        upward = np.eye(3)["xyz".index(self.up)]
        slope = float(rotation[2] @ upward)
        if slope < LEAST_SLOPE:  # the eye is below the ground
            return np.zeros((height, width), np.float32)
        x = (np.arange(width) + 0.5 - width / 2) * pixel
        y = (height / 2 - np.arange(height) - 0.5) * pixel
        across = np.multiply.outer(np.ones(height), x)
        along = np.multiply.outer(y, np.ones(width))
        away = self.level - float(centre @ upward)
        depth = (away - across * (rotation[0] @ upward) - along * (rotation[1] @ upward)) / slope
        feet = np.stack([across, along, depth], axis=-1) @ rotation + centre - self.centre
        column, row = np.moveaxis(feet @ self._axes()[:2].T, -1, 0) * PIXELS / (REACH * self.radius)
        places = [PIXELS / 2 - row - 0.5, PIXELS / 2 + column - 0.5]
        return np.asarray(map_coordinates(shadow, places, np.float32, order=1), np.float32)

    def _axes(self) -> Floats:
        """Rows: to the right, upwards and towards an eye below the ground."""
        right, down = np.eye(3)[0], -np.eye(3)["xyz".index(self.up)]
        return np.stack([right, np.cross(down, right), down])


def _lowest(points: Floats, up: Up) -> float:
    """How far down points reach along the upward axis [dx]; 0 if there are none."""
    heights = points[:, "xyz".index(up)]
    level = float(np.min(heights, where=np.isfinite(heights), initial=np.inf))
    return level if np.isfinite(level) else 0.0
