"""The circle the points start on and the star they should become (algorithm 10)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from chamfer_morph.reproduction.planar.config import PlanarConfig

Points = npt.NDArray[np.float64]


def circle_angles(config: PlanarConfig) -> Points:
    """Polar angles of the source points [radians], shape [point_count], float64."""
    if config.circle_angles == "random":
        draw = np.random.default_rng(config.seed).random(config.point_count)
        return np.sort(2 * np.pi * draw)
    return 2 * np.pi * np.arange(config.point_count) / config.point_count


def circle(config: PlanarConfig) -> Points:
    """The source points, shape [point_count, 2], float64."""
    return config.circle_radius * directions(circle_angles(config))


def star(config: PlanarConfig) -> Points:
    """The target points, shape [target_count, 2], float64."""
    position = np.arange(config.target_count, dtype=np.float64)
    if config.star_sampling == "between":
        position += 0.5
    elif config.star_sampling == "random":
        draw = np.random.default_rng([config.seed, 1]).random(config.target_count)
        position = config.target_count * np.sort(draw)
    return _along_star(config, position / config.target_count)


def even_star(config: PlanarConfig, count: int) -> Points:
    """The star as ``count`` points at even arc length from the first tip on, shape [count, 2]."""
    return _along_star(config, np.arange(count) / count)


def directions(angles: Points) -> Points:
    """Unit vectors at polar angles [radians]: shape [n] to [n, 2]."""
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _along_star(config: PlanarConfig, share: Points) -> Points:
    """Points at these shares of the outline's length, counted from the first tip."""
    corner_count = 2 * config.star_arms
    corner = np.arange(corner_count + 1)
    radius = np.where(corner % 2 == 0, config.star_outer_radius, config.star_inner_radius)
    turn = np.radians(config.star_orientation) + 2 * np.pi * corner / corner_count
    corners = radius[:, None] * directions(turn)
    # all edges are equally long, so that the share of the length is the share of the edges
    x, y = (np.interp(share * corner_count, corner, corners[:, axis]) for axis in (0, 1))
    return np.column_stack([x, y])
