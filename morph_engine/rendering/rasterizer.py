"""Spheres and triangles drawn with NumPy alone: no GPU, no display."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, minimum_filter, uniform_filter

from morph_engine.rendering.materials import Material, bent, light

Floats = npt.NDArray[np.float32]

LIGHT = np.array([-0.4, 0.6, 0.7], np.float32) / np.float32(np.linalg.norm([-0.4, 0.6, 0.7]))
AMBIENT = 0.45
TILES_PER_RADIUS = 2
HOLLOW_PIXELS = 8
"""Blur of the depth, in pixels of the coarse picture that finds hollows."""


PIXELS_AT_ONCE = 1 << 19
"""So many are shaded together, for the memory that takes."""

FLIP = np.array([1, -1, 1], np.float32)
"""Rows grow downwards."""

LARGE = 64.0
"""Spheres of a greater radius are drawn one after the other [pixels]; of those whose centres look
closer together than 1/64 of it, only the nearest."""

HALF = np.float32(0.5)
LEAST_AREA = 1e-9

Fragments = tuple[npt.NDArray[np.integer], Floats, npt.NDArray[np.intp]]


class Canvas:
    """A picture in the making: what is nearest at each pixel, its normal and its colour.

    Coordinates are pixels: x to the right, y upwards, z to the eye, 0 at the picture's centre.
    """

    def __init__(self, width: int, height: int) -> None:
        self._width, self._height = width, height
        self._middle = np.array([width / 2, height / 2, 0], np.float32)
        self._depth = np.full(width * height, -np.inf, np.float32)
        self._normal = np.zeros((width * height, 3), np.float32)
        self._color = np.zeros((width * height, 3), np.float32)

    @property
    def covered(self) -> npt.NDArray[np.bool_]:
        """Which pixels show something, shape [height, width]."""
        return np.isfinite(self._depth).reshape(self._height, self._width)

    @property
    def depth(self) -> Floats:
        """How near to the eye each pixel is [pixels], -inf where nothing is, [height, width]."""
        return self._depth.reshape(self._height, self._width)

    @property
    def colors(self) -> Floats:
        """What was drawn as colours, without light, shape [height, width, 3], float32."""
        return self._color.reshape(self._height, self._width, 3)

    def spheres(self, centres: Floats, radius: float, colors: Floats) -> None:
        """Draw spheres of one size.

        Args:
            centres: Positions [pixels], shape [n, 3], float32.
            radius: Their radius [pixels].
            colors: RGB, shape [n, 3], 0 to 1, float32.
        """
        in_sight = self._in_sight(centres, radius)
        centres, colors = centres[in_sight], colors[in_sight]
        if radius > LARGE:
            nearest = _nearest_of_each_place(centres, radius / LARGE)
            centres, colors = centres[nearest], colors[nearest]
        nearest_last = np.argsort(centres[:, 2])  # the last to be drawn on a pixel stays
        colors = colors[nearest_last]
        column, row, z = (centres[nearest_last] * FLIP + self._middle).T
        left, top = np.floor(column).astype(np.int32), np.floor(row).astype(np.int32)
        aside, below = left + HALF - column, top + HALF - row
        reach = int(np.ceil(radius))
        window = range(-reach, reach + 1)

        def by_sphere() -> Iterator[Fragments]:
            for index, corner in enumerate(zip(left.tolist(), top.tolist(), strict=True)):
                x, y = (
                    np.arange(max(0, middle - reach), min(edge, middle + reach + 1))
                    for middle, edge in zip(corner, (self._width, self._height), strict=True)
                )
                aside, below = x + HALF - column[index], y + HALF - row[index]
                bulge = np.float32(radius**2) - aside**2 - below[:, None] ** 2
                down, across = np.nonzero(bulge > 0)
                pixel = y[down] * self._width + x[across]
                yield pixel, z[index] + np.sqrt(bulge[down, across]), np.full(len(pixel), index)

        def by_offset() -> Iterator[Fragments]:
            # from the middle outwards, so that most of what is hidden is soon known to be
            for dx, dy in sorted(product(window, window), key=lambda d: d[0] ** 2 + d[1] ** 2):
                bulge = radius**2 - (aside + dx) ** 2 - (below + dy) ** 2
                shown = np.flatnonzero(
                    (bulge > 0)
                    & (left >= -dx)
                    & (left < self._width - dx)
                    & (top >= -dy)
                    & (top < self._height - dy)
                )
                pixel = (top[shown] + dy) * self._width + left[shown] + dx
                yield pixel, z[shown] + np.sqrt(bulge[shown]), shown

        pixel, owner = self._nearest(by_sphere() if radius > LARGE else by_offset())
        x, y = pixel % self._width + HALF - column[owner], row[owner] - pixel // self._width - HALF
        rise = np.sqrt(np.maximum(radius**2 - x**2 - y**2, 0))
        self._normal[pixel] = np.column_stack([x, y, rise]) / radius
        self._color[pixel] = colors[owner]

    def triangles(
        self, corners: Floats, normals: Floats, colors: Floats, faces: npt.NDArray[np.int32]
    ) -> None:
        """Draw the triangles that face the eye, smoothly shaded.

        Args:
            corners: Positions [pixels], shape [v, 3], float32.
            normals: Unit normals at the corners, shape [v, 3], float32.
            colors: RGB at the corners, shape [v, 3], 0 to 1, float32.
            faces: Indices of the corners, counter-clockwise seen from outside, shape [f, 3].
        """
        place = corners * FLIP + self._middle
        a, b, c = (place[faces[:, k], :2] for k in range(3))
        # rows grow downwards, which turns the winding over
        front = np.flatnonzero(_cross(b - a, c - a) < -LEAST_AREA)
        faces = faces[front[np.argsort(place[faces[front], 2].max(axis=1))]]
        a, b, c = (place[faces[:, k], :2] for k in range(3))
        limit = np.array([self._width, self._height], np.int32) - 1
        first = np.floor(np.minimum(np.minimum(a, b), c)).astype(np.int32).clip(0)
        last = np.floor(np.maximum(np.maximum(a, b), c)).astype(np.int32).clip(-1, limit)
        size = last - first + 1
        columns, rows = (int(extent) for extent in size.max(axis=0, initial=0))

        def shares(face: npt.NDArray[np.intp], point: Floats) -> Floats:
            """Barycentric coordinates."""
            to_a, to_b, to_c = a[face] - point, b[face] - point, c[face] - point
            parts = [_cross(to_b, to_c), _cross(to_c, to_a), _cross(to_a, to_b)]
            share: Floats = np.stack(parts, axis=1)
            share /= share.sum(axis=1, keepdims=True)
            return share

        def fragments() -> Iterator[Fragments]:
            for dx, dy in product(range(columns), range(rows)):
                near = np.flatnonzero((size[:, 0] > dx) & (size[:, 1] > dy))
                place_of = first[near] + np.array([dx, dy], np.int32)
                share = shares(near, place_of + HALF)
                within = (share >= 0).all(axis=1)
                shown, place_of = near[within], place_of[within]
                height = np.einsum("fk,fk->f", share[within], place[faces[shown], 2])
                yield place_of[:, 1] * self._width + place_of[:, 0], height, shown

        pixel, owner = self._nearest(fragments())
        point = np.stack([pixel % self._width, pixel // self._width], axis=1).astype(np.float32)
        share = shares(owner, point + HALF)
        normal = np.einsum("fk,fki->fi", share, normals[faces[owner]])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        self._normal[pixel] = normal / np.maximum(length, LEAST_AREA)
        self._color[pixel] = np.einsum("fk,fki->fi", share, colors[faces[owner]])

    def smooth(self, reach: int, apart: float) -> None:
        """Make one smooth surface of the spheres that were drawn, as fluids of particles are shown.

        Depths become their mean over neighbouring pixels on the same surface, in a narrow range of
        depths (Truong and Yuksel, A Narrow-Range Filter for Screen-Space Fluid Rendering, 2018),
        and normals the gradient of that.

        Args:
            reach: How far the mean goes [pixels].
            apart: What differs more in depth [pixels] is of another surface.
        """
        depth = self.depth
        for along in (0, 1, 0, 1):
            depth = _mean_along(depth, depth[..., None], along, reach, apart)[..., 0]
        self._depth = depth.reshape(-1)
        aside, below = (_least_slope(depth, along, apart) for along in (1, 0))
        normal = np.stack([-aside, below, np.ones_like(aside)], axis=2)
        for along in (0, 1):
            normal /= np.linalg.norm(normal, axis=2, keepdims=True)
            normal = _mean_along(depth, normal, along, reach, apart)
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        self._normal = normal.reshape(-1, 3)

    def lit(self, scale: float) -> Floats:
        """The picture under one light, darker in hollows that are looked for over `scale` [pixels].

        Returns:
            RGB, shape [height, width, 3], 0 to 1, float32; black where nothing is.
        """
        facing = np.clip(self._normal @ LIGHT, 0, 1)
        light = (AMBIENT + (1 - AMBIENT) * facing).reshape(self._height, self._width)
        shade = light * self._openness(scale)
        color = self._color.reshape(self._height, self._width, 3)
        lit: Floats = np.minimum(color * shade[..., None], np.float32(1))
        return lit

    def light(
        self,
        material: Material,
        scale: float,
        to_room: npt.NDArray[np.float64],
        *,
        colored: bool,
        behind: npt.NDArray[np.floating],
        radius: float,
    ) -> Floats:
        """The light of a material in a room, hollows as of `lit`.

        Args:
            material: The material.
            scale: Over which hollows are looked for [pixels].
            to_room: Rotation from the eye to the room, whose y points upwards, shape [3, 3].
            colored: Whether the colours that were drawn stand in place of the material's own.
            behind: Light from behind, linear RGB, and how far it hides what is farther away, shape
                [height, width, 4], or [4] where it is the same everywhere.
            radius: Of what is shown [pixels], which tells how far light is bent inside.

        Returns:
            Light and cover of the pixels that are `covered`, shape [n, 4], float32.
        """
        openness = self._openness(scale).reshape(-1)

        def lit(pixel: npt.NDArray[np.intp]) -> Floats:
            normal = self._normal[pixel]
            if behind.ndim == 1:
                seen = np.broadcast_to(behind, (len(pixel), 4))
            else:
                aside = radius * bent(material, normal) * FLIP[:2]
                place = np.stack([pixel % self._width, pixel // self._width], axis=1)
                place = (place + np.rint(aside)).clip(0, [self._width - 1, self._height - 1])
                column, row = place.astype(np.intp).T
                seen = behind[row, column]
            own = self._color[pixel] if colored else None
            return light(material, normal, openness[pixel], to_room, seen, own).astype(np.float32)

        pixels = np.flatnonzero(np.isfinite(self._depth))
        parts = np.array_split(pixels, 1 + len(pixels) // PIXELS_AT_ONCE)
        return np.concatenate([lit(part) for part in parts])

    def _nearest(
        self, fragments: Iterable[Fragments]
    ) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Put fragments on the pixels where nothing nearer is; of several the last stays.

        Returns:
            The pixels that show something of it, and the indices of what.
        """
        owner = np.full(len(self._depth), -1, np.int32)
        for pixel, z, index in fragments:
            seen = np.flatnonzero(z > self._depth[pixel])
            pixel = pixel[seen]
            self._depth[pixel] = z[seen]
            owner[pixel] = index[seen]
        covered = np.flatnonzero(owner >= 0)
        return covered, owner[covered].astype(np.intp)

    def _in_sight(self, centres: Floats, radius: float) -> npt.NDArray[np.intp]:
        """Spheres that may show; those left out lie behind others, as most of a fill does.

        A tile that a sphere covers wholly hides what lies behind the sphere's centre; a sphere is
        hidden where all tiles that it may touch hide it.
        """
        tile = radius / TILES_PER_RADIUS
        touched = TILES_PER_RADIUS + 1
        columns, rows = (int(extent / tile) + 2 for extent in (self._width, self._height))
        across = (self._width / 2 + centres[:, 0]) / tile
        down = (self._height / 2 - centres[:, 1]) / tile
        inside = (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
        column, row = (np.floor(place).astype(np.intp) for place in (across, down))
        hiding = np.full((rows, columns), -np.inf, np.float32)
        window = range(-TILES_PER_RADIUS, TILES_PER_RADIUS + 1)
        for dx, dy in product(window, window):
            x, y = column + dx, row + dy
            far = [
                np.maximum(np.abs(here - place), np.abs(here + 1 - place))
                for here, place in ((x, across), (y, down))
            ]
            covers = far[0] ** 2 + far[1] ** 2 < TILES_PER_RADIUS**2
            covers &= (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
            np.maximum.at(hiding, (y[covers], x[covers]), centres[covers, 2])
        least = minimum_filter(hiding, 2 * touched + 1, mode="nearest")
        shown = ~inside
        shown[inside] = centres[inside, 2] + radius >= least[row[inside], column[inside]]
        return np.flatnonzero(shown)

    def _openness(self, scale: float) -> Floats:
        """Over 1 where a pixel stands out from those around it, below 1 in a hollow."""
        scale = min(scale, HOLLOW_PIXELS * max(self._width, self._height))
        coarse = max(1, int(scale / HOLLOW_PIXELS))
        depth = self._depth.reshape(self._height, self._width)
        sparse = depth[::coarse, ::coarse]
        hit = np.isfinite(sparse)
        weight = gaussian_filter(hit.astype(np.float32), scale / coarse)
        around = gaussian_filter(np.where(hit, sparse, np.float32(0)), scale / coarse)
        around = around / np.maximum(weight, np.float32(1e-6))
        around = np.repeat(np.repeat(around, coarse, axis=0), coarse, axis=1)
        if coarse > 1:
            around = uniform_filter(around, coarse)
        height = np.where(np.isfinite(depth), depth, np.float32(0))
        apart = (height - around[: self._height, : self._width]) / np.float32(scale)
        openness: Floats = np.clip(1 + 0.35 * apart, 0.45, 1.25).astype(np.float32)
        return openness


def _nearest_of_each_place(centres: Floats, edge: float) -> npt.NDArray[np.intp]:
    """Indices of the points that are nearest in their square of this edge [pixels], shape [k]."""
    nearest_first = np.argsort(-centres[:, 2], kind="stable")
    place = np.floor(centres[nearest_first, :2] / edge).astype(np.int64)
    _, first = np.unique(place, axis=0, return_index=True)
    return nearest_first[first]


def _mean_along(depth: Floats, values: Floats, along: int, reach: int, apart: float) -> Floats:
    """A weighted mean of values at neighbouring pixels in a row or column, of one surface.

    Args:
        depth: Depths that tell surfaces apart, -inf where nothing is, shape [height, width].
        values: What the mean is of, shape [height, width, k].
        along: 0 for columns, 1 for rows.
        reach: How far it goes [pixels].
        apart: What differs more in depth is of another surface [pixels].
    """
    hit = np.isfinite(depth)
    known = np.where(hit[..., None], values, np.float32(0))
    total, weight = np.zeros_like(known), np.zeros_like(depth)
    for step in range(-reach, reach + 1):
        here, there = _pairs(step, along)
        with np.errstate(invalid="ignore"):  # of nothing and nothing
            near = np.abs(depth[there] - depth[here]) <= np.float32(apart)
        share = near * np.float32(np.exp(-2 * (step / reach) ** 2))
        total[here] += share[..., None] * known[there]
        weight[here] += share
    mean: Floats = np.where(
        hit[..., None], total / np.maximum(weight, LEAST_AREA)[..., None], values
    )
    return mean


def _least_slope(depth: Floats, along: int, apart: float) -> Floats:
    """The change of depth from pixel to pixel: the smaller one of both sides, on one surface."""
    slope = np.full_like(depth, np.inf)
    for step in (1, -1):
        here, there = _pairs(step, along)
        with np.errstate(invalid="ignore"):  # of nothing and nothing
            side = step * (depth[there] - depth[here])
        slope[here] = np.where(np.abs(side) < np.abs(slope[here]), side, slope[here])
    slope[np.abs(slope) > np.float32(apart)] = 0
    return slope


def _pairs(step: int, along: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Pixels, and those that lie some pixels further on."""
    first, last = slice(None, -abs(step) or None), slice(abs(step), None)
    here, there = (first, last) if step > 0 else (last, first)
    before = (slice(None),) * along
    return (*before, here), (*before, there)


def _cross(a: Floats, b: Floats) -> Floats:
    cross: Floats = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return cross
