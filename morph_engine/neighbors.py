"""Exact nearest neighbours on the device: a balanced box tree whose boxes follow moving points."""

from typing import Any

import numpy as np
import numpy.typing as npt
import taichi as ti

LEAF_SIZE = 8
REACH = 1e18  # a coordinate beyond this counts as non-finite
PARKED = 5e18  # where absent points wait; their squared distances stay finite in float32
NOTHING = 2e37  # squared distance above every possible match and below every parked point
REACH_BITS = int(np.float32(REACH).view(np.int32))
SLACK = 1.0 + 1e-5  # boxes are discarded only beyond this, so that rounding never hides a tie


@ti.func
def usable(point):
    """Tell whether all coordinates are within reach; compares bits, which fast-math keeps."""
    answer = True
    for axis in ti.static(range(3)):
        bits = ti.bit_cast(ti.cast(point[axis], ti.f32), ti.i32) & 0x7FFFFFFF
        answer = answer and bits < REACH_BITS
    return answer


@ti.func
def squared_gap(lower, upper, point):
    """Squared distance from a point to a box, 0 inside."""
    gap = ti.max(lower - point, point - upper, 0.0)
    return gap.dot(gap)


@ti.kernel
def fit_leaves(
    points: ti.types.ndarray(),
    order: ti.types.ndarray(),
    leaf_points: ti.types.ndarray(),
    lower: ti.types.ndarray(),
    upper: ti.types.ndarray(),
):
    """Copy the points into leaf order and fit the leaf boxes around them."""
    leaf_count = order.shape[0] // LEAF_SIZE
    for leaf in range(leaf_count):
        low = ti.Vector([PARKED, PARKED, PARKED])
        high = -low
        for lane in range(LEAF_SIZE):
            slot = leaf * LEAF_SIZE + lane
            source = order[slot]
            point = ti.Vector([PARKED, PARKED, PARKED])
            if source >= 0:
                if usable(points[source]):
                    point = points[source]
                    low = ti.min(low, point)
                    high = ti.max(high, point)
            leaf_points[slot] = point
        lower[leaf_count + leaf] = low
        upper[leaf_count + leaf] = high


@ti.kernel
def fit_level(first: int, lower: ti.types.ndarray(), upper: ti.types.ndarray()):
    """Fit the boxes of one level (nodes first .. 2 first - 1) around their two children."""
    for offset in range(first):
        node = first + offset
        lower[node] = ti.min(lower[2 * node], lower[2 * node + 1])
        upper[node] = ti.max(upper[2 * node], upper[2 * node + 1])


@ti.kernel
def search(
    queries: ti.types.ndarray(),
    guess: ti.types.ndarray(),
    guess_count: int,
    points: ti.types.ndarray(),
    order: ti.types.ndarray(),
    leaf_points: ti.types.ndarray(),
    lower: ti.types.ndarray(),
    upper: ti.types.ndarray(),
    index_out: ti.types.ndarray(),
    distance_out: ti.types.ndarray(),
):
    """Find the nearest point of every query by a stackless, nearest-child-first descent.

    Bit k of `trail` tells that the sibling of the k-th ancestor is still to be visited.
    """
    leaf_count = order.shape[0] // LEAF_SIZE
    for i in range(queries.shape[0]):
        query = queries[i]
        best = NOTHING
        match = -1
        node = 0
        trail = 1
        if usable(query):
            node = 1
            if i < guess_count:
                candidate = guess[i]
                if 0 <= candidate < points.shape[0]:
                    if usable(points[candidate]):
                        best = (points[candidate] - query).norm_sqr() * SLACK
        while node > 0:
            descended = False
            if node >= leaf_count:
                for lane in range(LEAF_SIZE):
                    slot = (node - leaf_count) * LEAF_SIZE + lane
                    squared = (leaf_points[slot] - query).norm_sqr()
                    if squared <= best:
                        source = order[slot]
                        if squared < best or match < 0 or source < match:
                            best = squared
                            match = source
            else:
                left = squared_gap(lower[2 * node], upper[2 * node], query)
                right = squared_gap(lower[2 * node + 1], upper[2 * node + 1], query)
                bound = best * SLACK
                if ti.min(left, right) <= bound:
                    trail = 2 * trail + ti.cast(ti.max(left, right) <= bound, ti.i32)
                    node = 2 * node + ti.cast(right < left, ti.i32)
                    descended = True
            if not descended:
                while trail & 1 == 0:
                    trail >>= 1
                    node >>= 1
                node ^= 1
                trail ^= 1
        index_out[i] = match
        distance_out[i] = ti.sqrt(best) if match >= 0 else ti.math.inf


class NeighborIndex:
    """Exact nearest-neighbour search over a point set that may move.

    The points are sorted once into the leaves of a balanced tree; when they move, only the boxes
    of the tree are fitted anew, which keeps every answer exact.

    Args:
        points: Point positions [dx], shape [n], 3-vectors of float32 or float64; n >= 1. Points
            with a coordinate that is not finite (or beyond 1e18) are never found.
    """

    def __init__(self, points: Any) -> None:
        self.point_count: int = points.shape[0]
        self._points = points
        leaf_count = 1 << (max(1, -(-self.point_count // LEAF_SIZE)) - 1).bit_length()
        real = points.element_type.element_type() if hasattr(points.element_type, "element_type") else points.dtype
        self._order = ti.ndarray(ti.i32, leaf_count * LEAF_SIZE)
        self._leaf_points = ti.Vector.ndarray(3, real, leaf_count * LEAF_SIZE)
        self._lower = ti.Vector.ndarray(3, real, 2 * leaf_count)
        self._upper = ti.Vector.ndarray(3, real, 2 * leaf_count)
        self._no_guess = ti.ndarray(ti.i32, 1)
        self._leaf_count = leaf_count
        self.rebuild(points)

    def rebuild(self, points: Any) -> None:
        """Sort the points into leaves anew; worth it after they moved by many spacings."""
        self._order.from_numpy(leaf_order(points.to_numpy(), self._leaf_count))
        self.update(points)

    def update(self, points: Any) -> None:
        """Follow points that moved: fit all boxes to the new positions.

        Args:
            points: New positions [dx], shape [n] as before, same dtype.
        """
        self._points = points
        fit_leaves(points, self._order, self._leaf_points, self._lower, self._upper)
        level = self._leaf_count // 2
        while level >= 1:
            fit_level(level, self._lower, self._upper)
            level //= 2

    def nearest(self, queries: Any, index_out: Any, distance_out: Any, guess: Any = None) -> None:
        """Find the nearest point of every query; of equally near ones that of lowest index.

        Args:
            queries: Query positions [dx], shape [m], 3-vectors, dtype of the points. Any order is
                right; neighbours in space that are neighbours in memory are fastest.
            index_out: Receives the index of the nearest point, shape [m], int32; -1 for a query
                with a non-finite coordinate.
            distance_out: Receives the distance [dx], shape [m], real; inf where the index is -1.
            guess: Indices of likely near points, shape [m], int32, for instance the previous
                answer; values out of range are ignored. May be `index_out` itself.
        """
        search(
            queries,
            self._no_guess if guess is None else guess,
            0 if guess is None else queries.shape[0],
            self._points,
            self._order,
            self._leaf_points,
            self._lower,
            self._upper,
            index_out,
            distance_out,
        )


def leaf_order(points: npt.NDArray[Any], leaf_count: int) -> npt.NDArray[np.int32]:
    """Sort points into the leaves of a tree that halves its longest axis at every level.

    Args:
        points: Positions, shape [n, 3].
        leaf_count: Number of leaves, a power of two; leaf_count * LEAF_SIZE >= n.

    Returns:
        Index of the point in every leaf slot, -1 for an empty slot, shape [leaf_count * LEAF_SIZE],
        int32. All leaves are full but the last ones.
    """
    slot_count = leaf_count * LEAF_SIZE
    positions = np.full((slot_count, 3), np.nan)
    positions[: len(points)] = points
    positions[~(np.abs(positions) < REACH).all(axis=1)] = np.nan
    order = np.arange(slot_count)
    size = slot_count
    while size > LEAF_SIZE:
        cells = order.reshape(-1, size)
        inside = positions[cells]
        with np.errstate(all="ignore"):
            low = np.fmin.reduce(inside, axis=1)
            high = np.fmax.reduce(inside, axis=1)
        axis = np.argmax(np.nan_to_num(high - low), axis=1)
        along = np.take_along_axis(inside, axis[:, None, None], axis=2)[:, :, 0]
        part = np.argpartition(along, size // 2, axis=1)
        order = np.take_along_axis(cells, part, axis=1).reshape(-1)
        size //= 2
    order = np.sort(order.reshape(-1, LEAF_SIZE), axis=1).reshape(-1)
    return np.where(order < len(points), order, -1).astype(np.int32)
