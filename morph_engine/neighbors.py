"""Exact nearest neighbours on the device: a balanced box tree whose boxes follow moving points.

The points lie in the leaves of a complete binary tree, stored without pointers: node k has the
children 2k and 2k + 1, its box holds all its points. On a CPU eight queries that are close in space
descend together, so that every box and every point is compared with a full vector of queries.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import taichi as ti

LEAF_SIZE = 32
LANES = 8  # queries that descend together on a CPU
SUBTREES = 64  # refitted in parallel
CELLS = 32  # per axis, of the grid that brings queries into a coherent order
REACH = 1e18  # a coordinate beyond this counts as non-finite
PARKED = 5e18  # where absent points wait: far away, yet at a finite squared distance
NOTHING = 2e37  # squared distance above every possible match and below every parked point
TINY = 1e-30  # keeps the search radius of a perfect match open
NO_MATCH = 2**31 - 1
SLACK = 1.0 + 1e-5  # a box is left out only beyond this, so that rounding never hides a match
REACH_BITS = int(np.float32(REACH).view(np.int32))


@ti.func
def within_reach(point):
    """Tell whether no coordinate is beyond REACH; compares bits, which holds under fast-math."""
    answer = True
    for axis in ti.static(range(3)):
        bits = ti.bit_cast(ti.cast(point[axis], ti.f32), ti.i32) & 0x7FFFFFFF
        answer = answer and bits <= REACH_BITS
    return answer


@ti.func
def gap(lower, upper, along):
    """Distance along one axis to an interval, 0 inside; comparisons vectorise, ti.max does not."""
    below = lower - along
    above = along - upper
    outside = ti.select(below > above, below, above)
    return ti.select(outside > 0.0, outside, 0.0)


@ti.func
def fit_node(node, lower: ti.template(), upper: ti.template()):
    """Fit the box of an inner node around those of its children."""
    lower[node] = ti.min(lower[2 * node], lower[2 * node + 1])
    upper[node] = ti.max(upper[2 * node], upper[2 * node + 1])


@ti.kernel
def fit_boxes(
    points: ti.types.ndarray(),
    order: ti.types.ndarray(),
    leaf_points: ti.types.ndarray(),
    lower: ti.types.ndarray(),
    upper: ti.types.ndarray(),
):
    """Copy the points into their leaves and fit all boxes, from the leaves to the root."""
    for leaf in range(lower.shape[0] // 2):
        low = ti.Vector([PARKED, PARKED, PARKED])
        high = -low
        for slot in range(leaf * LEAF_SIZE, (leaf + 1) * LEAF_SIZE):
            point = ti.Vector([PARKED, PARKED, PARKED])
            source = order[slot]
            if source != NO_MATCH:
                if within_reach(points[source]):
                    point = points[source]
                    low = ti.min(low, point)
                    high = ti.max(high, point)
            leaf_points[slot] = point
        lower[lower.shape[0] // 2 + leaf] = low
        upper[lower.shape[0] // 2 + leaf] = high
    for subtree in range(ti.min(lower.shape[0] // 2, SUBTREES)):
        root = ti.min(lower.shape[0] // 2, SUBTREES) + subtree
        width = lower.shape[0] // 4 // ti.min(lower.shape[0] // 2, SUBTREES)
        while width > 0:
            for node in range(root * width, (root + 1) * width):
                fit_node(node, lower, upper)
            width //= 2
    ti.loop_config(serialize=True)
    for k in range(1, ti.min(lower.shape[0] // 2, SUBTREES)):
        fit_node(ti.min(lower.shape[0] // 2, SUBTREES) - k, lower, upper)


@ti.kernel
def sort_by_cell(
    queries: ti.types.ndarray(),
    bounds: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    cell_end: ti.types.ndarray(),
    visit: ti.types.ndarray(),
):
    """List the queries cell by cell, cells along a Morton curve: a counting sort."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        low = ti.Vector([PARKED, PARKED, PARKED])
        high = -low
        for i in range(queries.shape[0]):
            if within_reach(queries[i]):
                low = ti.min(low, queries[i])
                high = ti.max(high, queries[i])
        bounds[0] = low
        bounds[1] = high - low
    for i in range(queries.shape[0]):
        code = 0
        if within_reach(queries[i]):
            scale = (CELLS - 1) / ti.max(bounds[1].max(), 1e-6)
            along = ti.cast((queries[i] - bounds[0]) * scale, ti.i32)
            for axis, bit in ti.static(ti.ndrange(3, 5)):
                code |= (along[axis] >> bit & 1) << (3 * bit + axis)
        cell[i] = ti.max(0, ti.min(code, CELLS**3 - 1))
    ti.loop_config(serialize=True)
    for _ in range(1):
        for c in range(CELLS**3):
            cell_end[c] = 0
        for i in range(queries.shape[0]):
            cell_end[cell[i]] = cell_end[cell[i]] + 1  # += would be atomic, and slow
        for c in range(1, CELLS**3):
            cell_end[c] = cell_end[c] + cell_end[c - 1]
        for k in range(queries.shape[0]):
            i = queries.shape[0] - 1 - k
            place = cell_end[cell[i]] - 1
            cell_end[cell[i]] = place
            visit[place] = i


@ti.kernel
def search(
    lanes: ti.template(),
    guided: ti.template(),
    queries: ti.types.ndarray(),
    visit: ti.types.ndarray(),
    guess: ti.types.ndarray(),
    points: ti.types.ndarray(),
    order: ti.types.ndarray(),
    leaf_points: ti.types.ndarray(),
    lower: ti.types.ndarray(),
    upper: ti.types.ndarray(),
    index_out: ti.types.ndarray(),
    distance_out: ti.types.ndarray(),
):
    """Find the nearest point of every query: depth first, nearer child first, without a stack.

    Bit k of `trail` tells that the sibling of the k-th ancestor is still to be visited; the root's
    bit ends the search. Statements on `lanes`-vectors compile to vector instructions.
    """
    query_count = queries.shape[0]
    leaf_count = lower.shape[0] // 2
    for packet in range((query_count + lanes - 1) // lanes):
        x = ti.Vector([0.0] * lanes)
        y = ti.Vector([0.0] * lanes)
        z = ti.Vector([0.0] * lanes)
        best = ti.Vector([-1.0] * lanes)
        match = ti.Vector([NO_MATCH] * lanes)
        for lane in ti.static(range(lanes)):
            i = ti.min(packet * lanes + lane, query_count - 1)
            if ti.static(lanes > 1):
                i = visit[i]
            if within_reach(queries[i]):
                x[lane], y[lane], z[lane] = queries[i]
                best[lane] = NOTHING
                if ti.static(guided):
                    candidate = guess[i]
                    if 0 <= candidate < points.shape[0]:
                        if within_reach(points[candidate]):
                            best[lane] = (points[candidate] - queries[i]).norm_sqr() * SLACK
        middle = ti.Vector([x.sum(), y.sum(), z.sum()]) / lanes

        limit = best * SLACK + TINY
        node = 1
        trail = 1
        while node > 0:
            low = lower[node]
            high = upper[node]
            gap_x = gap(low[0], high[0], x)
            gap_y = gap(low[1], high[1], y)
            gap_z = gap(low[2], high[2], z)
            excess = gap_x * gap_x + gap_y * gap_y + gap_z * gap_z - limit
            wanted = 0
            for lane in ti.static(range(lanes)):
                wanted |= ti.cast(excess[lane] <= 0.0, ti.i32)
            if wanted != 0 and node < leaf_count:
                left = gap(lower[2 * node], upper[2 * node], middle)
                right = gap(lower[2 * node + 1], upper[2 * node + 1], middle)
                node = 2 * node + ti.cast(right.norm_sqr() < left.norm_sqr(), ti.i32)
                trail = 2 * trail + 1
            else:
                if wanted != 0:
                    near = limit
                    nearest = ti.Vector([NO_MATCH] * lanes)
                    first = (node - leaf_count) * LEAF_SIZE
                    for slot in range(first, first + LEAF_SIZE):
                        dx = x - leaf_points[slot][0]
                        dy = y - leaf_points[slot][1]
                        dz = z - leaf_points[slot][2]
                        squared = dx * dx + dy * dy + dz * dz
                        closer = squared < near
                        near = ti.select(closer, squared, near)
                        nearest = ti.select(closer, order[slot], nearest)
                    tie = (near == best) & (nearest < match)
                    match = ti.select((near < best) | tie, nearest, match)
                    best = ti.select(near < best, near, best)
                    limit = best * SLACK + TINY
                while trail & 1 == 0:
                    trail >>= 1
                    node >>= 1
                trail ^= 1
                node ^= 1

        for lane in ti.static(range(lanes)):
            i = packet * lanes + lane
            if i < query_count:
                if ti.static(lanes > 1):
                    i = visit[i]
                found = match[lane] != NO_MATCH
                index_out[i] = match[lane] if found else -1
                distance_out[i] = ti.sqrt(best[lane]) if found else ti.math.inf


class NeighborIndex:
    """Exact nearest-neighbour search over a point set that may move.

    The points are sorted once into the leaves of a balanced tree; when they move, only the boxes
    of the tree are fitted anew, which keeps every answer exact.

    Args:
        points: Point positions [dx], shape [n], 3-vectors of float32 or float64; n >= 1. Points
            with a coordinate that is not finite (or beyond 1e18) are never found.
    """

    def __init__(self, points: Any) -> None:
        self._leaf_count = 1 << (-(-points.shape[0] // LEAF_SIZE) - 1).bit_length()
        slot_count = self._leaf_count * LEAF_SIZE
        real = points.dtype
        self._order = ti.ndarray(ti.i32, slot_count)
        self._leaf_points = ti.Vector.ndarray(3, real, slot_count)
        self._lower = ti.Vector.ndarray(3, real, 2 * self._leaf_count)
        self._upper = ti.Vector.ndarray(3, real, 2 * self._leaf_count)
        self._bounds = ti.Vector.ndarray(3, real, 2)
        self._cell_end = ti.ndarray(ti.i32, CELLS**3)
        self._cell = self._visit = ti.ndarray(ti.i32, 1)
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
        fit_boxes(points, self._order, self._leaf_points, self._lower, self._upper)

    def nearest(self, queries: Any, index_out: Any, distance_out: Any, guess: Any = None) -> None:
        """Find the nearest point of every query; of equally near ones that of lowest index.

        Args:
            queries: Query positions [dx], shape [m], 3-vectors, dtype of the points.
            index_out: Receives the index of the nearest point, shape [m], int32; -1 for a query
                with a non-finite coordinate.
            distance_out: Receives the distance [dx], shape [m], real; inf where the index is -1.
            guess: Indices of likely near points, shape [m], int32, for instance the previous
                answer; values out of range are ignored. May be `index_out` itself.
        """
        if self._visit.shape[0] != queries.shape[0]:
            self._cell = ti.ndarray(ti.i32, queries.shape[0])
            self._visit = ti.ndarray(ti.i32, queries.shape[0])
        sort_by_cell(queries, self._bounds, self._cell, self._cell_end, self._visit)
        search(
            LANES,
            guess is not None,
            queries,
            self._visit,
            self._visit if guess is None else guess,
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
        Index of the point in every leaf slot, NO_MATCH for an empty one, int32, shape
        [leaf_count * LEAF_SIZE]. All leaves are full but the last ones.
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
    return np.where(order < len(points), order, NO_MATCH).astype(np.int32)
