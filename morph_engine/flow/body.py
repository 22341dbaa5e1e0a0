"""The body at each share of its change: a level set, and the mass that it holds at grid nodes.

Both ends are given by signed distances phi_0 and phi_1. At the share s the body is::

    B(s) = { x : phi_s(x) < c_s },    phi_s = (1 - s) g(phi_0) + s g(phi_1),

with c_s such that its volume is (1 - s) V_0 + s V_1. Distances outside grow like a logarithm,
g(d) = L log(1 + d / L) for d > 0: a limb grows at an even pace then, instead of at the very end.

Where a warp w carries the source's parts to where they belong, both distances go along with it::

    phi_s(x) = (1 - s) g(phi_0(w_s^-1 x)) + s g(phi_1(w_1 w_s^-1 x))

Surface tension rounds the body on its way: phi_s is smoothed by a Gaussian of width 4 s (1 - s) T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from morph_engine.flow.carrier import REFINEMENT, Carrier
from morph_engine.flow.warp import Warp
from morph_engine.mpm import Grid

Field = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Body:
    """One state of the body.

    Attributes:
        level: phi_s - c_s on the fine lattice [dx], shape [m, m, m]; negative inside.
        mass: What a node shall hold, over what a node deep inside holds at the source's density,
            shape [r, r, r].
    """

    level: Field
    mass: Field


def fine_axis(grid: Grid) -> NDArray[np.float64]:
    """Coordinates of the fine lattice along an axis [dx]; every second one is a grid node."""
    count = REFINEMENT * (grid.resolution - 1) + 1
    return np.arange(count, dtype=np.float64) * (grid.dx / REFINEMENT) + grid.origin


class BodyPath:
    """The body at every share of its change.

    Args:
        source: Signed distance to the source on the fine lattice [dx], shape [m, m, m].
        target: Signed distance to the target.
        grid: The grid whose nodes the matter is counted at.
        reach: L, beyond which distances outside are compressed [dx].
        matter: All mass, over what a node deep inside holds at the source's density.
        tension: T, width of the smoothing half-way [dx].
        warp: What carries the distances, if anything does.
    """

    def __init__(
        self,
        source: Field,
        target: Field,
        grid: Grid,
        *,
        reach: float,
        matter: float,
        tension: float = 0.0,
        warp: Warp | None = None,
    ) -> None:
        self._ends = [_compressed(distance, reach) for distance in (source, target)]
        self._inside = [int(np.count_nonzero(distance < 0)) for distance in (source, target)]
        self._grid = grid
        self._matter = matter
        self._tension = tension
        self._carrier = Carrier(warp, self._ends, grid) if warp else None

    @property
    def volumes(self) -> tuple[float, float]:
        """Volume of the source and of the target [dx^3]."""
        cell = (self._grid.dx / REFINEMENT) ** 3
        return self._inside[0] * cell, self._inside[1] * cell

    def at(self, share: float) -> Body:
        """The body after a share of its change, between 0 and 1."""
        if self._carrier:
            level = self._carrier.blended(share)
        else:
            first, last = self._ends
            level = (1 - np.float32(share)) * first + np.float32(share) * last
        level = self._rounded(level, 4 * share * (1 - share) * self._tension)
        count = round((1 - share) * self._inside[0] + share * self._inside[1])
        level -= _quantile(level, count)
        if 0 < share < 1:
            level = self._without_threads(level)
        return Body(level, self._mass(*self._smoothed(level)))

    def _rounded(self, level: Field, width: float) -> Field:
        """Smooth the level by a Gaussian of some width [dx], where the surface can be."""
        if not width:
            return level
        step = self._grid.dx / REFINEMENT
        level = np.minimum(level, np.float32(FARTHEST))
        box = _bounding_box(level < FARTHEST)
        level[box] = scipy.ndimage.gaussian_filter(level[box], width / step, mode="nearest")
        return level

    def _without_threads(self, level: Field) -> Field:
        """Give up what is too thin for particles: threads of limbs that come or go."""
        indicator, box = self._smoothed(level)
        kept = scipy.ndimage.binary_dilation(indicator > THREAD, iterations=REFINEMENT + 1)
        if not np.any((level[box] < 0) & ~kept):
            return level
        step = np.float32(self._grid.dx / REFINEMENT)
        away = step * scipy.ndimage.distance_transform_edt(~kept).astype(np.float32)
        level[box] = np.where(kept, level[box], np.maximum(level[box], away))
        return level

    def _smoothed(self, level: Field) -> tuple[Field, tuple[slice, ...]]:
        """Indicator of the body as quadratic B-splines see it, in a box, and the box."""
        box = _bounding_box(level < self._grid.dx)
        step = self._grid.dx / REFINEMENT
        indicator = np.clip(0.5 - level[box] / step, 0, 1)
        for axis in range(3):
            indicator = scipy.ndimage.convolve1d(indicator, SPLINE, axis=axis, mode="constant")
        return indicator, box

    def _mass(self, indicator: Field, box: tuple[slice, ...]) -> Field:
        """The matter at nodes, all of it."""
        mass = np.zeros((self._grid.resolution,) * 3, np.float32)
        nodes = indicator[::REFINEMENT, ::REFINEMENT, ::REFINEMENT]
        corner = tuple(
            slice(s.start // REFINEMENT, s.start // REFINEMENT + n)
            for s, n in zip(box, nodes.shape, strict=True)
        )
        mass[corner] = nodes
        return mass * np.float32(self._matter / mass.sum(dtype=np.float64))


THREAD = 0.3
"""Smoothed indicator below which the body is a thread thinner than some 0.6 grid cells."""

FARTHEST = 6.0
"""Levels beyond this do not tell where a smooth body ends [dx]."""

NEAR = 2.0
"""Where the surface of the body is looked for first: levels of this size [dx]."""

SPLINE = np.array([1, 4, 6, 4, 1], np.float32) / 16
"""Quadratic B-spline of a grid cell's width at the points of the fine lattice."""


def _compressed(distance: Field, reach: float) -> Field:
    outside = np.maximum(distance, 0)
    return np.where(
        distance > 0, np.float32(reach) * np.log1p(outside / np.float32(reach)), distance
    )


def _quantile(level: Field, count: int) -> np.float32:
    """The value that so many values of the field are below."""
    near = level[np.abs(level) < NEAR]
    position = count - int(np.count_nonzero(level <= -NEAR))
    if not 0 <= position < len(near):  # the ends lie far apart
        near, position = level.ravel(), count
    return np.partition(near, position)[position]


def _bounding_box(mask: NDArray[np.bool_]) -> tuple[slice, ...]:
    """The least box of whole grid cells with margins around what is marked."""
    box = []
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        marked = np.flatnonzero(mask.any(axis=others))
        first = max(marked[0] - REFINEMENT, 0) // REFINEMENT * REFINEMENT
        box.append(slice(int(first), int(marked[-1]) + REFINEMENT + 1))
    return tuple(box)
