"""How many particles are within a radius of each target point: the numbers of a search, sooner.

Particles are listed by bins: columns of a square cell along z, cut into short pieces, which follow
one another. Target points are taken in blocks of BLOCK^3 cells. Where a bin lies beside a block
tells of most bins that their particles are within the radius of all points of the block, or of
none; in each column the former follow one another, so that two numbers say how many there are. The
others, which the spheres around the points cut, are copied to one place and looked at one by one in
float32, and in float64 where rounding could decide.

A block is one thread's and counts are integers: the number of threads changes nothing.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine.backend import CPU_CHUNK_STRIDE
from morph_engine.counting_sort import counting_sort
from morph_engine.flow.cell_list import LANES, load_lanes
from morph_engine.geometry.point_cloud import extent
from morph_engine.row_blocks import row_blocks

CHUNKS = 32
"""Parts in which threads share out the blocks."""

BLOCK = 3
BINS_PER_CELL = 2

ROOM = 8192
"""Particles that a part has room for, LANES more not counted."""

MOST_BINS = 1 << 27
BINS_PER_POINT = 128
"""With more bins than that they take too much memory."""

ROUNDING = 1e-6
"""Relative to the radius squared: above the error of a squared distance in float32, of coordinates
that are float32 numbers themselves."""

SLACK = 1e-6
"""What bins are taken to be larger by, for the rounding of what falls into them [cells]."""


@dataclass(frozen=True, eq=False)
class Runs:
    """The bins beside a block that the ball around some point of it cuts, column by column.

    Attributes:
        column: Columns, counted along x and y from the first of the block, shape [c, 2].
        bins: Where balls begin and end in them, counted from the first bin of the block: around
            some points, around all, around all no more, around none; shape [c, 4].
    """

    column: NDArray[np.int64]
    bins: NDArray[np.int64]

    @classmethod
    def beside(cls, low: NDArray[np.float64], high: NDArray[np.float64], reach: float) -> "Runs":
        """The bins for points that are from `low` to `high` in their block; lengths in cells."""
        most = math.ceil(reach) + BLOCK
        offsets = np.arange(-most, most + 1)
        columns = np.stack(np.meshgrid(offsets, offsets, indexing="ij"), axis=-1).reshape(-1, 2)
        before, after = low[:2] - columns - 1, columns - high[:2]
        least = np.maximum(0, np.maximum(before, after) - SLACK)
        farthest = np.maximum(-before, -after) + 1 + SLACK
        left = reach**2 - (least**2).sum(axis=1)
        cut = left > 0
        columns, left = columns[cut], left[cut]
        left_of_all = reach**2 - (farthest[cut] ** 2).sum(axis=1)
        half, half_of_all = np.sqrt(left) + SLACK, np.sqrt(np.maximum(left_of_all, 0)) - SLACK
        begin = np.floor(BINS_PER_CELL * (low[2] - half))
        end = np.floor(BINS_PER_CELL * (high[2] + half)) + 1
        begin_all = np.ceil(BINS_PER_CELL * (high[2] - half_of_all))
        end_all = np.floor(BINS_PER_CELL * (low[2] + half_of_all))
        none = begin_all >= end_all
        begin_all[none] = end_all[none] = end[none]
        bins = np.stack([begin, begin_all, end_all, end], axis=1)
        return cls(columns, bins.astype(np.int64))


class BallCounts:
    """Counts particles around the points of a target.

    Args:
        goal: Target points [dx], shape [m, 3], float32, finite.
        spacing: About how far they are apart [dx].
        radius: Within which particles count [dx].
    """

    def __init__(self, goal: NDArray[np.float32], spacing: float, radius: float) -> None:
        self.radius = radius
        self.spacing = spacing
        least = extent(goal)[0].astype(np.float64)
        place = (goal - least) / spacing
        # so that points of a lattice are in the middle of cells, wherever they are a little off it
        beside = extent(place - np.floor(place))[1]
        self._origin = least - spacing * (1 - beside) / 2
        place += (1 - beside) / 2
        block = np.floor(place / BLOCK)
        place -= BLOCK * block
        reach = radius / spacing
        self._runs = Runs.beside(*extent(place), reach)
        self._margin = math.ceil(reach) + BLOCK + 1
        blocks = extent(block)[1] + 1
        self._bins: NDArray[np.float64] = BLOCK * blocks + 2 * self._margin
        self._bins[2] *= BINS_PER_CELL
        self.possible: bool = bool(
            self._bins.prod() < min(BINS_PER_POINT * (len(goal) + 1024), MOST_BINS)
        )
        if not self.possible:
            return
        key = ((block[:, 0] * blocks[1] + block[:, 1]) * blocks[2] + block[:, 2]).astype(np.int32)
        self._order, first = counting_sort(key, int(blocks.prod()))
        begin = first[:-1][np.diff(first) > 0]
        self._begin = np.append(begin, len(goal)).astype(np.int32)
        self._base = self._flat(
            self._cell_to_bin(BLOCK * block[self._order[begin]] + self._margin)
        ).astype(np.int32)
        self._goal = goal[self._order]

    def of(self, particles: NDArray[np.float32]) -> NDArray[np.int32]:
        """How many particles [dx], shape [n, 3], float32, are within the radius of each point."""
        bins = self._bins_of(particles)
        near = bins >= 0
        if not near.all():
            particles, bins = particles[near], bins[near]
        order, first = counting_sort(bins, int(self._bins.prod()))
        columns = np.zeros((3, len(particles) + LANES), np.float32)
        for column, coordinates in zip(columns, particles.T, strict=True):
            np.take(coordinates, order, out=column[: len(particles)], mode="clip")  # unbuffered
        offsets = self._flat(np.insert(self._runs.column, 2, 0, axis=1))
        found = np.zeros(len(self._goal), np.int32)
        count_in_balls(
            self._goal,
            self._begin,
            self._base,
            (offsets[:, None] + self._runs.bins).astype(np.int32),
            first,
            columns[0],
            columns[1],
            columns[2],
            *(np.empty(CHUNKS * (ROOM + LANES), np.float32) for _ in range(3)),
            found,
            self.radius,
        )
        counts = np.empty_like(found)
        counts[self._order] = found
        return counts

    def _bins_of(self, particles: NDArray[np.float32]) -> NDArray[np.int32]:
        """The bin that each particle is in, shape [n]; -1 where that is far from all points."""
        bins = np.empty(len(particles), np.int32)
        for rows in row_blocks(len(particles)):
            place = (particles[rows] - self._origin) / self.spacing + self._margin
            place = np.floor(self._cell_to_bin(place))
            near = ((place >= 0) & (place < self._bins)).T
            bins[rows] = np.where(near[0] & near[1] & near[2], self._flat(place), -1)
        return bins

    def _cell_to_bin(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        place[:, 2] *= BINS_PER_CELL
        return place

    def _flat(self, bins: NDArray[Any]) -> NDArray[Any]:
        """Index of a bin, or of the difference between two."""
        flat: NDArray[Any] = (bins[:, 0] * self._bins[1] + bins[:, 1]) * self._bins[2] + bins[:, 2]
        return flat


@ti.func
def store_lanes(column: ti.template(), first: int, values):
    """Set the LANES numbers of a column from one on."""
    for lane in ti.static(range(LANES)):
        column[first + lane] = values[lane]


@ti.kernel
def count_in_balls(
    goal: ti.types.ndarray(dtype=ti.f32, ndim=2),
    begin: ti.types.ndarray(dtype=ti.i32, ndim=1),
    base: ti.types.ndarray(dtype=ti.i32, ndim=1),
    runs: ti.types.ndarray(dtype=ti.i32, ndim=2),
    first: ti.types.ndarray(dtype=ti.i32, ndim=1),
    x_column: ti.types.ndarray(dtype=ti.f32, ndim=1),
    y_column: ti.types.ndarray(dtype=ti.f32, ndim=1),
    z_column: ti.types.ndarray(dtype=ti.f32, ndim=1),
    x_cut: ti.types.ndarray(dtype=ti.f32, ndim=1),
    y_cut: ti.types.ndarray(dtype=ti.f32, ndim=1),
    z_cut: ti.types.ndarray(dtype=ti.f32, ndim=1),
    found: ti.types.ndarray(dtype=ti.i32, ndim=1),
    radius: ti.f64,
):
    """Count the particles around each target point, block by block.

    Each column has particles that a sphere may cut on two sides. Particles are copied LANES at a
    time, of which the next ones take the place of those too many. One more turn is for what is left
    to be looked at.
    """
    square = radius * radius
    surely = ti.cast(square * (1 - ROUNDING), ti.f32)
    maybe = ti.cast(square * (1 + ROUNDING), ti.f32)
    for task in range(CHUNKS * CPU_CHUNK_STRIDE):
        if task % CPU_CHUNK_STRIDE == 0:
            chunk, blocks = task // CPU_CHUNK_STRIDE, base.shape[0]
            place, sides = chunk * ti.static(ROOM + LANES), 2 * runs.shape[0]
            for block in range(chunk * blocks // CHUNKS, (chunk + 1) * blocks // CHUNKS):
                inside, cut = 0, 0
                for side in range(sides + 1):
                    at, end = 0, 0
                    if side < sides:
                        column, far = side // 2, side % 2 * 2
                        at = first[base[block] + runs[column, far]]
                        end = first[base[block] + runs[column, far + 1]]
                        if far == 0:
                            inside += first[base[block] + runs[column, 2]] - end
                    for piece in range(ti.max((end - at + LANES - 1) // LANES, 1)):
                        slot = at + piece * LANES
                        store_lanes(x_cut, place + cut, load_lanes(x_column, slot))
                        store_lanes(y_cut, place + cut, load_lanes(y_column, slot))
                        store_lanes(z_cut, place + cut, load_lanes(z_column, slot))
                        cut += ti.min(end - slot, LANES)
                        if cut > ROOM - LANES or side == sides:
                            for q in range(begin[block], begin[block + 1]):
                                x, y, z = goal[q, 0], goal[q, 1], goal[q, 2]
                                some, most = 0, 0
                                for n in range(place, place + cut):
                                    dx, dy, dz = x - x_cut[n], y - y_cut[n], z - z_cut[n]
                                    apart = dx * dx + dy * dy + dz * dz
                                    some += ti.cast(apart <= surely, ti.i32)
                                    most += ti.cast(apart <= maybe, ti.i32)
                                if some != most:
                                    for n in range(place, place + cut):
                                        dx, dy, dz = x - x_cut[n], y - y_cut[n], z - z_cut[n]
                                        apart = dx * dx + dy * dy + dz * dz
                                        if surely < apart and apart <= maybe:
                                            exact_x = ti.cast(x, ti.f64) - x_cut[n]
                                            exact_y = ti.cast(y, ti.f64) - y_cut[n]
                                            exact_z = ti.cast(z, ti.f64) - z_cut[n]
                                            exact = exact_x**2 + exact_y**2 + exact_z**2
                                            some += ti.cast(exact <= square, ti.i32)
                                found[q] += some
                            cut = 0
                for q in range(begin[block], begin[block + 1]):
                    found[q] += inside
