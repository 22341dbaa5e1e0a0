"""Gaussian average of particle values over neighbouring cells, in linear time (algorithm 5.3).

The average runs over all particles in the 27 cells around a particle, some 700 of them. Within a
pair of cells the Gaussian is smooth and separates by axis, so it is interpolated: each particle
hands its value to the 3^3 Chebyshev nodes of its cell, the nodes of neighbouring cells exchange
sums one axis at a time, and each particle reads its own cell's nodes. The error, relative to the
largest average, is below 5e-4 at sigma = 3 dx, 2e-3 at 2 dx and about 1e-2 at dx.
"""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from morph_engine import backend
from morph_engine.mpm.grid import Grid

ORDER = 3  # Chebyshev nodes per cell and axis
NODES = ORDER**3
SMALLEST_WEIGHT = 1e-12


class GaussianSmoothing:
    """Averages vectors at moving particles, by a Gaussian of standard deviation sigma [dx].

    The cells of the background grid delimit the neighbourhood.
    """

    def __init__(self, grid: Grid, sigma: float) -> None:
        self._grid = grid
        self._table = backend.active().scalars(3 * ORDER * ORDER)
        self._table.from_numpy(_exchange_table(sigma * grid.dx, grid.dx))
        self._sums = self._scratch = backend.active().vectors(NODES, 4)

    def apply(self, x: Any, values: Any) -> None:
        """Average values in place, shape [n, 3], at particles x [dx], shape [n, 3]."""
        device = backend.active()
        low, size = self._occupied_cells(x.to_numpy())
        count = int(np.prod(size)) * NODES
        if self._sums.shape[0] < count:
            self._sums, self._scratch = device.vectors(count, 4), device.vectors(count, 4)
        lows, sizes = ti.Vector(low.tolist()), ti.Vector(size.tolist())
        lanes = 1 if device.on_cpu else x.shape[0]
        _spread(x, values, self._sums, lows, sizes, count, lanes, self._grid, not device.on_cpu)
        for axis in range(3):
            _exchange(self._sums, self._scratch, self._table, sizes, axis, count)
            self._sums, self._scratch = self._scratch, self._sums
        _read(x, values, self._sums, lows, sizes, self._grid)

    def _occupied_cells(self, x: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Lowest cell and number of cells per axis of the box that holds all particles."""
        g = self._grid
        cells = np.clip(np.floor((np.nan_to_num(x) - g.origin) / g.dx), 0, g.resolution - 1).astype(
            int
        )
        low = cells.min(axis=0)
        return low, cells.max(axis=0) - low + 1


def _chebyshev_nodes() -> NDArray[np.float64]:
    return 0.5 - 0.5 * np.cos((np.arange(ORDER) + 0.5) * np.pi / ORDER)


def _exchange_table(sigma: float, dx: float) -> NDArray[np.float64]:
    """Gaussian between node a of a cell and node b of the cell at offset o-1, flat [o, a, b]."""
    t = _chebyshev_nodes()
    offset = np.arange(-1, 2)[:, None, None]
    gap = dx * (t[None, :, None] - t[None, None, :] - offset)
    return np.asarray(np.exp(-(gap**2) / (2 * sigma**2)).ravel())


@ti.func
def _lagrange(t: float):
    """Interpolation weights of the Chebyshev nodes at t in [0, 1]."""
    nodes = ti.static([float(node) for node in _chebyshev_nodes()])
    result = ti.Vector.one(float, ORDER)
    for a in ti.static(range(ORDER)):
        for b in ti.static(range(ORDER)):
            if ti.static(a != b):
                result[a] *= (t - nodes[b]) / (nodes[a] - nodes[b])
    return result


@ti.func
def _locate(position, low, size, grid: ti.template()):
    """First node of a particle's cell in the box, and its place in the cell per axis."""
    place = (position - grid.origin) / grid.dx
    cell = ti.math.clamp(ti.floor(place, int), low, low + size - 1)
    local = cell - low
    first = ((local.x * size.y + local.y) * size.z + local.z) * NODES
    return first, ti.math.clamp(place - cell, 0.0, 1.0)


@ti.kernel
def _spread(
    x: ti.types.ndarray(),
    values: ti.types.ndarray(),
    sums: ti.types.ndarray(),
    low: ti.types.vector(3, int),
    size: ti.types.vector(3, int),
    count: int,
    lanes: int,
    grid: ti.template(),
    atomic: ti.template(),
):
    """Each particle's (value, 1) to the nodes of its cell; on the CPU in particle order."""
    for i in range(count):
        sums[i] = ti.zero(sums[i])
    chunk = (x.shape[0] + lanes - 1) // lanes
    for lane in range(lanes):
        for p in range(lane * chunk, ti.min((lane + 1) * chunk, x.shape[0])):
            first, t = _locate(x[p], low, size, grid)
            wx, wy, wz = _lagrange(t.x), _lagrange(t.y), _lagrange(t.z)
            value = ti.Vector([values[p].x, values[p].y, values[p].z, 1.0])
            for a, b, c in ti.static(ti.ndrange(ORDER, ORDER, ORDER)):
                node = first + (a * ORDER + b) * ORDER + c
                share = wx[a] * wy[b] * wz[c] * value
                if ti.static(atomic):
                    ti.atomic_add(sums[node], share)
                else:
                    sums[node] = sums[node] + share


@ti.kernel
def _exchange(
    sums: ti.types.ndarray(),
    result: ti.types.ndarray(),
    table: ti.types.ndarray(),
    size: ti.types.vector(3, int),
    axis: ti.template(),
    count: int,
):
    """Each node gathers along one axis from the nodes of its own and the two adjacent cells."""
    node_stride = ti.static(ORDER ** (2 - axis))
    for i in range(count):
        cell = i // NODES
        place = ti.Vector([cell // (size.y * size.z), (cell // size.z) % size.y, cell % size.z])
        cell_stride = NODES * ti.Vector([size.y * size.z, size.z, 1])[axis]
        a = (i // node_stride) % ORDER
        total = ti.zero(sums[i])
        for o in range(3):
            if 0 <= place[axis] + o - 1 and place[axis] + o - 1 < size[axis]:
                first = i - a * node_stride + (o - 1) * cell_stride
                for b in ti.static(range(ORDER)):
                    total += table[(o * ORDER + a) * ORDER + b] * sums[first + b * node_stride]
        result[i] = total


@ti.kernel
def _read(
    x: ti.types.ndarray(),
    values: ti.types.ndarray(),
    sums: ti.types.ndarray(),
    low: ti.types.vector(3, int),
    size: ti.types.vector(3, int),
    grid: ti.template(),
):
    """Each particle's average from the nodes of its cell."""
    for p in range(x.shape[0]):
        first, t = _locate(x[p], low, size, grid)
        wx, wy, wz = _lagrange(t.x), _lagrange(t.y), _lagrange(t.z)
        total = ti.zero(sums[0])
        for a, b, c in ti.static(ti.ndrange(ORDER, ORDER, ORDER)):
            total += wx[a] * wy[b] * wz[c] * sums[first + (a * ORDER + b) * ORDER + c]
        average = ti.Vector.zero(float, 3)
        if total.w > SMALLEST_WEIGHT:
            average = total.xyz / total.w
        values[p] = average
