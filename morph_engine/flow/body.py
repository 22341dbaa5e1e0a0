"""The body at each share of its change: a level set, and the mass that it holds at grid nodes.

At the share s the body is { x : phi_s(x) < c_s } with c_s such that its volume is
(1 - s) V_0 + s V_1. Between shapes that have little in common phi is a blend of their signed
distances (`level_blend`), taken at such a share that equal steps change the body equally.

Where a warp w carries the source's parts to where they belong, both distances go along with it,
compressed outside as there (g)::

    phi_s(x) = (1 - s) g(phi_0(w_s^-1 x)) + s g(phi_1(w_1 w_s^-1 x))
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from morph_engine.flow.carrier import REFINEMENT, Carrier, Level, Places
from morph_engine.flow.level_blend import Blend, Field, compressed, rounded
from morph_engine.flow.node_box import NodeBox
from morph_engine.flow.warp import Warp
from morph_engine.mpm import Grid

THREAD = 0.3
"""Smoothed indicator below which the body is a thread thinner than some 0.6 grid cells."""

LEAST_PIECE = 100
"""Lattice points of the smallest separate piece of the body that is kept, some 40 particles; where
most of an end is in pieces less than twice as large, half of what these have."""

LARGE_PIECE = 0.1
"""Share of the body from which a separate piece is kept though neither end has it."""

NEAR = 2.0
"""Where the surface of the body is looked for first: levels of this size [dx]."""

LEAST_SLOPE = 0.3
"""Slopes of the level below this do not tell how far its surface is."""

SAMPLES = 21
"""Shares at which the change of the body is measured."""

LEAST_CHANGE = 0.05
"""What the body counts as changed from source to target, whatever it does."""

AROUND = 2
"""Grid cells around the body in which its level is given; from 1.5 on it is a distance to nodes."""

Box = tuple[slice, ...]


@dataclass(frozen=True, eq=False)
class Body:
    """One state of the body.

    Attributes:
        level: Signed distance to its surface on the fine lattice around it: to first order near the
            surface, and to the nearest node inside from farther out.
        mass: What a node shall hold, over what a node deep inside holds at the source's density,
            shape [r, r, r].
        box: The nodes that shall hold any.
    """

    level: Level
    mass: Field
    box: NodeBox


@dataclass(frozen=True, eq=False)
class Indicator:
    """1 inside a body and 0 outside, in a box.

    Attributes:
        box: The part of a level that it is given for.
        sharp: The share of each point of the lattice that is inside.
        smooth: That as quadratic B-splines see it.
    """

    box: Box
    sharp: Field
    smooth: Field


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

    Attributes:
        corner: The lowest point of the fine lattice that bodies ever reach, shape [3].
        size: Points from there to the highest along each axis, shape [3].
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
        self._step = grid.dx / REFINEMENT
        self._inside = [int(np.count_nonzero(distance < 0)) for distance in (source, target)]
        sizes = [_piece_sizes(distance) for distance in (source, target)]
        self._least_piece = min(LEAST_PIECE, *(_median_piece(pieces) / 2 for pieces in sizes))
        self._most_pieces = max(int((pieces >= self._least_piece).sum()) for pieces in sizes)
        self._grid = grid
        self._matter = matter
        self._tension = tension
        self._carrier: Carrier | None = None
        self._blended: Callable[[float], Level]
        self.corner: NDArray[np.int64]
        self.size: NDArray[np.int64]
        if warp:
            carrier = Carrier(warp, [compressed(end, reach) for end in (source, target)], grid)
            self.corner, self.size = carrier.corner, carrier.size
            self._carrier = carrier
        else:
            box = _bounding_box(np.minimum(source, target) < 0, margin=4)
            first, last = (np.ascontiguousarray(end[box]) for end in (source, target))
            blend = Blend(first, last, self._step, reach=reach, tension=tension)
            coarse = [np.ascontiguousarray(end[::2, ::2, ::2]) for end in (first, last)]
            inside = [int(np.count_nonzero(distance < 0)) for distance in coarse]
            shares = _even_shares(blend.coarser(*coarse), *inside)
            self.corner = np.array([along.start for along in box])
            self.size = np.array([along.stop - along.start for along in box])
            self._blended = lambda share: Level(self.corner, blend.at(_interpolated(shares, share)))

    @property
    def volumes(self) -> tuple[float, float]:
        """Volume of the source and of the target [dx^3]."""
        return self._inside[0] * self._step**3, self._inside[1] * self._step**3

    def at(self, share: float) -> Body:
        """The body after a share of its change, between 0 and 1."""
        return self.body(share, self.level(share, self.places(share)))

    @property
    def carried(self) -> bool:
        """Whether a warp carries the distances."""
        return self._carrier is not None

    def places(self, share: float) -> Places | None:
        """What a carried level is made from; any thread may ask for it."""
        return self._carrier.places(share) if self._carrier else None

    def level(self, share: float, places: Places | None) -> Level:
        """The level of the body before it has the scheduled volume.

        Where the path is carried, a kernel makes it, which one thread alone may launch.
        """
        if not (self._carrier and places):
            return self._blended(share)
        level = self._carrier.blended(share, places)
        width = 4 * share * (1 - share) * self._tension / self._step
        return Level(level.corner, rounded(level.values, width)) if width else level

    def body(self, share: float, level: Level) -> Body:
        """The body of a level that `level` returned, which is changed."""
        values = level.values
        values -= _quantile(values, round((1 - share) * self._inside[0] + share * self._inside[1]))
        around = _bounding_box(values < 0, margin=AROUND)
        corner = level.corner + [along.start for along in around]
        near = values[around]
        known = None
        if 0 < share < 1:
            near = self._as_distance(near)
            known = self._indicator(near)
            near = self._without_pieces(self._without_threads(near, known))
        near = self._leading_back(near)
        indicator = self._indicator(near, known)
        mass = self._mass(indicator.smooth, corner + [along.start for along in indicator.box])
        return Body(Level(corner, near), *mass)

    def _as_distance(self, level: Field) -> Field:
        """Divide the level by its slope."""
        slope: Field = np.zeros_like(level)
        for axis in range(3):
            along = _slope(level, axis) * np.float32(1 / self._step)
            slope += np.square(along, out=along)
        np.sqrt(slope, out=slope)
        np.maximum(slope, np.float32(LEAST_SLOPE), out=slope)
        return np.divide(level, slope, out=slope)

    def _without_threads(self, level: Field, indicator: Indicator) -> Field:
        """Give up what is too thin for particles: threads of limbs that come or go."""
        within, thick = level[indicator.box], indicator.smooth > THREAD
        if np.any((within < 0) & ~thick):
            kept = _dilated(thick, REFINEMENT + 1)
            np.maximum(within, self._step, out=within, where=~kept)
        return level

    def _without_pieces(self, level: Field) -> Field:
        """Give up separate pieces that hold but a few particles, and small ones no end has."""
        pieces, count = scipy.ndimage.label(level < 0)
        if count > 1:
            sizes = np.bincount(pieces.ravel())[1:]
            kept = sizes >= LARGE_PIECE * sizes.sum()
            kept[np.argsort(-sizes, kind="stable")[: self._most_pieces]] = True
            kept = np.append(False, kept & (sizes >= self._least_piece))  # by label
            given_up = (pieces > 0) & ~kept[pieces]
            level = np.where(given_up, np.maximum(level, -level), level)
        return level

    def _leading_back(self, level: Field) -> Field:
        """The distance to the body's nodes in place of the level, but for those near its surface.

        Blended levels have local minima outside, where particles left behind would stay.
        """
        outside = level[::REFINEMENT, ::REFINEMENT, ::REFINEMENT] >= 0
        cells = refined(_distance_to_others(outside))
        dx = np.float32(self._grid.dx)
        far = (cells > 1.5) & (level > 0)
        cells *= dx
        np.minimum(level, 1.5 * dx, out=cells, where=~far)
        return cells

    def _indicator(self, level: Field, known: Indicator | None = None) -> Indicator:
        """The indicator of a level; the known one where that has not changed, as most do not."""
        box = _bounding_box(level < self._grid.dx, margin=1)
        sharp = level[box] / self._step
        np.clip(np.subtract(0.5, sharp, out=sharp), 0, 1, out=sharp)
        if known and known.box == box and np.array_equal(known.sharp, sharp):
            return known
        return Indicator(box, sharp, smoothed(sharp))

    def _mass(self, indicator: Field, corner: NDArray[np.int64]) -> tuple[Field, NodeBox]:
        """The matter at nodes, all of it, and the nodes that have it.

        Args:
            indicator: Of the body, in a box of the fine lattice.
            corner: The lowest point of the box, counted from the grid's, shape [3].
        """
        mass = np.zeros((self._grid.resolution,) * 3, np.float32)
        nodes = indicator[::REFINEMENT, ::REFINEMENT, ::REFINEMENT]
        low = corner // REFINEMENT
        held = NodeBox(low, low + nodes.shape)
        mass[tuple(map(slice, held.low, held.high))] = nodes
        return mass * np.float32(self._matter / mass.sum(dtype=np.float64)), held


def _even_shares(blend: Blend, first: int, last: int) -> NDArray[np.float64]:
    """Shares of a blend between which the body changes by equal volumes, evenly spaced.

    So many points of the lattice are inside the first shape, and inside the last one.
    """
    shares = np.linspace(0, 1, SAMPLES)
    change, before = np.zeros(SAMPLES), blend.at(0.0) < 0
    for i, share in enumerate(shares[1:], start=1):
        level = blend.at(share)
        inside = level < _quantile(level, round((1 - share) * first + share * last))
        change[i] = np.count_nonzero(inside != before)
        before = inside
    changed = np.cumsum(change) + LEAST_CHANGE * max(change.sum(), 1) * shares
    even: NDArray[np.float64] = np.interp(shares * changed[-1], changed, shares)
    return even


def _interpolated(shares: NDArray[np.float64], share: float) -> float:
    return float(np.interp(share, np.linspace(0, 1, len(shares)), shares))


def refined(field: Field) -> Field:
    """A field given at every second point of a lattice, trilinear between them, [2 n - 1, ...]."""
    finer = field
    for axis in (2, 1, 0):
        size = list(finer.shape)
        size[axis] = 2 * size[axis] - 1
        coarse, finer = np.moveaxis(finer, axis, 0), np.empty(size, np.float32)
        along = np.moveaxis(finer, axis, 0)
        along[::2] = coarse
        np.add(coarse[:-1], coarse[1:], out=along[1::2])
        along[1::2] *= np.float32(0.5)
    return finer


def smoothed(field: Field) -> Field:
    """A field, 0 beyond its box, as quadratic B-splines of a grid cell's width see it.

    On the fine lattice they are (1, 4, 6, 4, 1) / 16 along each axis: four sums of neighbours.
    """
    for axis in range(3):
        for _ in range(4):
            field = _sums_of_neighbors(field, axis)
    within = field[2:-2, 2:-2, 2:-2]
    return within * np.float32(16**-3)


def _sums_of_neighbors(field: Field, axis: int) -> Field:
    """Sums of each point and the next along an axis, one more than there are points."""
    size = list(field.shape)
    size[axis] += 1
    sums = np.empty(size, np.float32)
    values, along = np.moveaxis(field, axis, 0), np.moveaxis(sums, axis, 0)
    along[0], along[-1] = values[0], values[-1]
    np.add(values[1:], values[:-1], out=along[1:-1])
    return sums


def _slope(field: Field, axis: int) -> Field:
    """Central differences along an axis, one-sided at its ends, for a lattice step of 1."""
    slope = np.empty_like(field)
    values, along = np.moveaxis(field, axis, 0), np.moveaxis(slope, axis, 0)
    np.subtract(values[2:], values[:-2], out=along[1:-1])
    along[1:-1] *= np.float32(0.5)
    along[0], along[-1] = values[1] - values[0], values[-1] - values[-2]
    return slope


def _dilated(mask: NDArray[np.bool_], times: int) -> NDArray[np.bool_]:
    """The points from which a marked one is at most so many lattice steps away."""
    for _ in range(times):
        wider = mask.copy()
        for axis in range(3):
            here, there = np.moveaxis(mask, axis, 0), np.moveaxis(wider, axis, 0)
            there[1:] |= here[:-1]
            there[:-1] |= here[1:]
        mask = wider
    return mask


def _distance_to_others(mask: NDArray[np.bool_]) -> Field:
    """How far each marked point is from the nearest one that is not [lattice steps]."""
    nearest: NDArray[np.int32] = scipy.ndimage.distance_transform_edt(
        mask, return_distances=False, return_indices=True
    )
    nearest -= np.indices(mask.shape, np.int32)
    np.square(nearest, out=nearest)
    return np.sqrt(nearest.sum(axis=0, dtype=np.int32)).astype(np.float32)


def _piece_sizes(distance: Field) -> NDArray[np.intp]:
    """Lattice points of each separate piece of a shape."""
    inside = distance < 0
    pieces, _ = scipy.ndimage.label(inside[_bounding_box(inside, margin=0)])
    return np.bincount(pieces.ravel())[1:]


def _median_piece(sizes: NDArray[np.intp]) -> int:
    """Size of the piece that a point of the shape is in, as the median over all points."""
    ascending = np.sort(sizes)
    return int(ascending[np.searchsorted(np.cumsum(ascending), sizes.sum() / 2)])


def _quantile(level: Field, count: int) -> np.float32:
    """The value that so many values of the field are below."""
    near = level[np.abs(level) < NEAR]
    position = count - int(np.count_nonzero(level <= -NEAR))
    if not 0 <= position < len(near):  # the ends lie far apart
        near, position = level.ravel(), count
    return np.partition(near, position)[position]


def _bounding_box(mask: NDArray[np.bool_], *, margin: int) -> Box:
    """The least box of whole grid cells, with so many more around what is marked."""
    box = []
    for axis, size in enumerate(mask.shape):
        others = tuple(a for a in range(3) if a != axis)
        marked = np.flatnonzero(mask.any(axis=others))
        first = max(marked[0] // REFINEMENT - margin, 0) * REFINEMENT
        last = min(-(-marked[-1] // REFINEMENT) + margin, (size - 1) // REFINEMENT) * REFINEMENT
        box.append(slice(int(first), int(last) + 1))
    return tuple(box)
