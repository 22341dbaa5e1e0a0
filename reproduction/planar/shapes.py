"""The circle the points start on and the star they should become (algorithm 10)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

CIRCLE_RADIUS = 0.8
STAR_ARMS = 5
STAR_OUTER_RADIUS, STAR_INNER_RADIUS = 1.0, 0.25


def circle_angles(count: int) -> Points:
    """Polar angles of the source points [radians], evenly around, shape [count], float64."""
    return 2 * np.pi * np.arange(count) / count


def circle(count: int) -> Points:
    """The source points, shape [count, 2], float64."""
    return CIRCLE_RADIUS * directions(circle_angles(count))


def star(count: int) -> Points:
    """The star as points at even arc length from its upper tip on, shape [count, 2], float64."""
    corner_count = 2 * STAR_ARMS
    corner = np.arange(corner_count + 1)
    radius = np.where(corner % 2 == 0, STAR_OUTER_RADIUS, STAR_INNER_RADIUS)
    corners = radius[:, None] * directions(np.pi / 2 + 2 * np.pi * corner / corner_count)
    # all edges are equally long, so that the share of the length is the share of the edges
    place = np.arange(count) / count * corner_count
    x, y = (np.interp(place, corner, corners[:, axis]) for axis in (0, 1))
    return np.column_stack([x, y])


def directions(angles: Points) -> Points:
    """Unit vectors at polar angles [radians]: shape [n] to [n, 2]."""
    return np.column_stack([np.cos(angles), np.sin(angles)])
