"""Exact nearest neighbours on the device: a balanced box tree whose boxes follow moving points.

The points lie in the leaves of a complete binary tree stored without pointers: node k has the
children 2k and 2k + 1, leaf l is node leaf_count + l, and the box of a node holds all its points.
Moving points keep their leaves, only the boxes are fitted anew, so every answer stays exact.

On a CPU, LANES queries close in space descend together: each box and each point is compared with
all of them by vector instructions. On a GPU every thread follows one query.
"""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend

LEAF_SIZE = 32
LANES = 8
SUBTREES = 64  # whose boxes are fitted in parallel
CELL_BITS = 5  # per axis, of the grid that brings queries into a coherent order
REACH = 1e18  # a coordinate beyond this counts as non-finite
PARKED = 5e18  # where absent points wait: far away, yet at a finite squared distance
NOTHING = 2e37  # squared distance above every possible match and below every parked point
NO_MATCH = 2**31 - 1
SLACK = 1.0 + 1e-5  # a box is left out only beyond this, so that rounding never hides a match
TINY = 1e-30  # keeps the search radius around a perfect match open
REACH_BITS = int(np.float32(REACH).view(np.int32))

TreeArrays: Any = ti.types.argpack(
    **dict.fromkeys(("leaf_of", "order", "leaf_points", "lower", "upper"), ti.types.ndarray())
)
"""Where each point lies, the points leaf by leaf, and the boxes of the nodes."""


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
    """Distance to an interval, 0 inside; ti.select compiles to fewer instructions than ti.max."""
    below = lower - along
    above = along - upper
    outside = ti.select(below > above, below, above)
    return ti.select(outside > 0.0, outside, 0.0)


@ti.func
def fit_inner_box(node, lower: ti.template(), upper: ti.template()):
    """Fit the box of a node around those of its children."""
    lower[node] = ti.min(lower[2 * node], lower[2 * node + 1])
    upper[node] = ti.max(upper[2 * node], upper[2 * node + 1])


@ti.kernel
def fit_boxes(
    leaf_count: int,
    root_count: int,
    points: ti.types.ndarray(),
    order: ti.types.ndarray(),
    leaf_points: ti.types.ndarray(),
    lower: ti.types.ndarray(),
    upper: ti.types.ndarray(),
):
    """Copy the points to their leaves and fit all boxes: leaves, `root_count` subtrees, the top."""
    for leaf in range(leaf_count):
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
        lower[leaf_count + leaf] = low
        upper[leaf_count + leaf] = high
    for root in range(root_count, 2 * root_count):
        width = leaf_count // root_count // 2
        while width > 0:
            for node in range(root * width, (root + 1) * width):
                fit_inner_box(node, lower, upper)
            width //= 2
    ti.loop_config(serialize=True)
    for k in range(1, root_count):
        fit_inner_box(root_count - k, lower, upper)


@ti.kernel
def sort_by_cell(
    queries: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    cell_end: ti.types.ndarray(),
    visit: ti.types.ndarray(),
):
    """List the queries cell by cell: a counting sort, serial.

    The cells follow a Morton curve in Gray order: one bit changes from a cell to the next.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        low = ti.Vector([PARKED, PARKED, PARKED])
        high = -low
        for i in range(queries.shape[0]):
            if within_reach(queries[i]):
                low = ti.min(low, queries[i])
                high = ti.max(high, queries[i])
        scale = ((1 << CELL_BITS) - 1) / ti.max((high - low).max(), 1e-6)

        for c in range(cell_end.shape[0]):
            cell_end[c] = 0
        for i in range(queries.shape[0]):
            code = 0
            if within_reach(queries[i]):
                along = ti.cast((queries[i] - low) * scale, ti.i32)
                for axis, bit in ti.static(ti.ndrange(3, CELL_BITS)):
                    code |= (along[axis] >> bit & 1) << (3 * bit + axis)
                for shift in ti.static((1, 2, 4, 8)):
                    code ^= code >> shift
            cell[i] = code
            cell_end[code] = cell_end[code] + 1  # += would be atomic, and slow
        for c in range(1, cell_end.shape[0]):
            cell_end[c] = cell_end[c] + cell_end[c - 1]
        for k in range(queries.shape[0]):
            i = queries.shape[0] - 1 - k
            place = cell_end[cell[i]] - 1
            cell_end[cell[i]] = place
            visit[place] = i


@ti.func
def query_at(place, lanes: ti.template(), visit: ti.template(), query_count):
    """Index of the query at a place of the visiting order; the last one fills up the packet."""
    i = ti.min(place, query_count - 1)
    if ti.static(lanes > 1):
        i = visit[i]
    return i


@ti.kernel
def search(
    lanes: ti.template(),
    guided: ti.template(),
    leaf_count: int,
    queries: ti.types.ndarray(),
    visit: ti.types.ndarray(),
    guess: ti.types.ndarray(),
    tree: TreeArrays,
    index_out: ti.types.ndarray(),
    distance_out: ti.types.ndarray(),
):
    """Find the nearest point of every query: depth first, nearer child first, without a stack.

    Bit k of `trail` tells that the sibling of the k-th ancestor is still to be visited; the bit of
    the root ends the search. A guess starts it in a leaf, with all siblings still to be visited.
    """
    query_count = queries.shape[0]
    for packet in range((query_count + lanes - 1) // lanes):
        x = ti.Vector([0.0] * lanes)
        y = ti.Vector([0.0] * lanes)
        z = ti.Vector([0.0] * lanes)
        best = ti.Vector([-1.0] * lanes)  # squared distance; a lane at -1 finds nothing
        match = ti.Vector([NO_MATCH] * lanes)
        for lane in ti.static(range(lanes)):
            query = queries[query_at(packet * lanes + lane, lanes, visit, query_count)]
            if within_reach(query):
                x[lane], y[lane], z[lane] = query
                best[lane] = NOTHING
        middle = ti.Vector([x.sum(), y.sum(), z.sum()]) / lanes
        limit = best * SLACK + TINY

        node = 1
        trail = 1
        if ti.static(guided):
            first_guess = guess[query_at(packet * lanes, lanes, visit, query_count)]
            if 0 <= first_guess < tree.leaf_of.shape[0]:
                node = tree.leaf_of[first_guess]
                trail = 2 * leaf_count - 1

        while node > 0:
            low = tree.lower[node]
            high = tree.upper[node]
            gap_x = gap(low[0], high[0], x)
            gap_y = gap(low[1], high[1], y)
            gap_z = gap(low[2], high[2], z)
            excess = gap_x * gap_x + gap_y * gap_y + gap_z * gap_z - limit
            wanted = 0
            for lane in ti.static(range(lanes)):
                wanted |= ti.cast(excess[lane] <= 0.0, ti.i32)

            if wanted != 0 and node < leaf_count:
                left = gap(tree.lower[2 * node], tree.upper[2 * node], middle)
                right = gap(tree.lower[2 * node + 1], tree.upper[2 * node + 1], middle)
                node = 2 * node + ti.cast(right.norm_sqr() < left.norm_sqr(), ti.i32)
                trail = 2 * trail + 1
            else:
                if wanted != 0:
                    near = limit
                    nearest = ti.Vector([NO_MATCH] * lanes)
                    first = (node - leaf_count) * LEAF_SIZE
                    for slot in range(first, first + LEAF_SIZE):
                        dx = x - tree.leaf_points[slot][0]
                        dy = y - tree.leaf_points[slot][1]
                        dz = z - tree.leaf_points[slot][2]
                        squared = dx * dx + dy * dy + dz * dz
                        closer = squared < near
                        near = ti.select(closer, squared, near)
                        nearest = ti.select(closer, tree.order[slot], nearest)
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
            if packet * lanes + lane < query_count:
                i = query_at(packet * lanes + lane, lanes, visit, query_count)
                found = match[lane] != NO_MATCH
                index_out[i] = match[lane] if found else -1
                distance_out[i] = ti.sqrt(best[lane]) if found else ti.math.inf


class NeighborIndex:
    """Exact nearest-neighbour search over a point set that may move.

    Args:
        points: Point positions [dx], device array, shape [n, 3], n >= 1. A point with a coordinate
            that is not finite (or beyond 1e18) is never found.
        lanes: Queries that descend together; by default LANES on a CPU and 1 on a GPU.
    """

    def __init__(self, points: Any, *, lanes: int | None = None) -> None:
        device = backend.active()
        self._lanes = lanes or (LANES if device.on_cpu else 1)
        self._point_count: int = points.shape[0]
        self._leaf_count = 1 << (-(-self._point_count // LEAF_SIZE) - 1).bit_length()
        self._order = device.integers(self._leaf_count * LEAF_SIZE)
        self._leaf_of = device.integers(self._point_count)
        self._leaf_points = device.vectors(self._leaf_count * LEAF_SIZE)
        self._lower = device.vectors(2 * self._leaf_count)
        self._upper = device.vectors(2 * self._leaf_count)
        self._tree = TreeArrays(
            leaf_of=self._leaf_of,
            order=self._order,
            leaf_points=self._leaf_points,
            lower=self._lower,
            upper=self._upper,
        )
        self._cell_end = device.integers(1 << 3 * CELL_BITS)
        self._cell = self._visit = device.integers(1)
        self.rebuild(points)

    def rebuild(self, points: Any) -> None:
        """Sort the points [dx], device array, shape [n, 3] as before, into leaves on the host.

        Worth its cost, about that of four searches, when points have moved relative to their
        neighbours by several spacings: after four, searches take nearly twice as long.

        Raises:
            ValueError: The number of points differs.
        """
        self._require_point_count(points)
        order = leaf_order(points.to_numpy(), self._leaf_count)
        leaf_of = np.argsort(order, kind="stable")[: self._point_count] // LEAF_SIZE
        self._order.from_numpy(order)
        self._leaf_of.from_numpy((leaf_of + self._leaf_count).astype(np.int32))
        self.update(points)

    def update(self, points: Any) -> None:
        """Fit all boxes to points that moved [dx], device array, shape [n, 3] as at the start.

        Raises:
            ValueError: The number of points differs.
        """
        self._require_point_count(points)
        fit_boxes(
            self._leaf_count,
            min(self._leaf_count, SUBTREES),
            points,
            self._order,
            self._leaf_points,
            self._lower,
            self._upper,
        )

    def nearest(self, queries: Any, index_out: Any, distance_out: Any, guess: Any = None) -> None:
        """Find the nearest point of every query; of equally near ones that of lowest index.

        Args:
            queries: Query positions [dx], device array, shape [m, 3], in any order.
            index_out: Receives the index of the nearest point, int32 device array, shape [m]; -1
                where there is none, as for a query with a coordinate that is not finite.
            distance_out: Receives the distance [dx], real device array, shape [m]; inf where the
                index is -1.
            guess: Likely answers, such as the previous ones, int32 device array, shape [m]. They
                speed up the search, whatever they hold. May be `index_out` itself.

        Raises:
            ValueError: The arrays differ in length.
        """
        count = queries.shape[0]
        lengths = {
            array.shape[0] for array in (index_out, distance_out, guess) if array is not None
        }
        if lengths != {count}:
            raise ValueError(f"{count} queries, but arrays of length {sorted(lengths)}")
        if self._lanes > 1:
            if self._visit.shape[0] != count:
                self._cell = backend.active().integers(count)
                self._visit = backend.active().integers(count)
            sort_by_cell(queries, self._cell, self._cell_end, self._visit)
        search(
            self._lanes,
            guess is not None,
            self._leaf_count,
            queries,
            self._visit,
            index_out if guess is None else guess,
            self._tree,
            index_out,
            distance_out,
        )

    def _require_point_count(self, points: Any) -> None:
        if points.shape[0] != self._point_count:
            raise ValueError(f"{points.shape[0]} points for an index of {self._point_count}")


def leaf_order(points: NDArray[np.floating[Any]], leaf_count: int) -> NDArray[np.int32]:
    """Sort points into the leaves of a tree that halves its boxes across their longest side.

    Args:
        points: Positions, shape [n, 3].
        leaf_count: Number of leaves, a power of two, leaf_count * LEAF_SIZE >= n.

    Returns:
        Index of the point in every leaf slot, NO_MATCH in an empty one, ascending in each leaf,
        shape [leaf_count * LEAF_SIZE]. All leaves are full but the last ones.
    """
    count, slot_count = len(points), leaf_count * LEAF_SIZE
    present = (np.abs(points) <= REACH).all(axis=1)
    coordinates = np.full((3, slot_count), PARKED, dtype=np.float32)
    coordinates[:, :count][:, present] = points[present].T
    order = np.arange(slot_count)
    size = slot_count
    while size > LEAF_SIZE:
        used = -(-count // size)  # boxes before the first one without a point
        boxes = coordinates[:, : used * size].reshape(3, used, size)
        highest = np.where(boxes < PARKED, boxes, -PARKED).max(axis=2)
        axis = np.argmax(highest - boxes.min(axis=2), axis=0)
        halves = np.argpartition(boxes[axis, np.arange(used)], size // 2, axis=1)
        slots = (halves + size * np.arange(used)[:, None]).reshape(-1)
        coordinates[:, : slots.size] = coordinates[:, slots]
        order[: slots.size] = order[slots]
        size //= 2
    order = np.where(order < count, order, NO_MATCH)
    return np.sort(order.reshape(-1, LEAF_SIZE), axis=1).reshape(-1).astype(np.int32)
