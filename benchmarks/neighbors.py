"""Rows on exact nearest neighbours: `python -m benchmarks.neighbors [shape or mesh]`."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.comparison import Row, speedup, table
from benchmarks.peers.kdtree import KdTreeNeighbors
from benchmarks.timing import interleaved
from morph_engine import backend
from morph_engine.geometry.neighbor_index import NeighborIndex
from morph_engine.geometry.sampling import sample_lattice
from morph_engine.geometry.shapes import resolve_shape

Points = NDArray[np.float32]

SPACING = 1 / 3  # of the lattices [dx]
SURFACE_COUNT = 74_000
REPEATS, QUICK_REPEATS = 25, 7
TOLERANCE = 1e-5  # float32 rounding of coordinates up to 16
NEAR, FAR = (3.0, 6.0), (8.0, 15.0)  # at least, aim


class EngineNeighbors:
    """The engine's index over targets, asked for all queries."""

    def __init__(self, targets: Points, queries: Points) -> None:
        device = backend.start("cpu", threads=2)
        self.targets, self.queries = device.upload(targets), device.upload(queries)
        self.matches, self.distances = device.integers(len(queries)), device.scalars(len(queries))
        self.index = NeighborIndex(self.targets)

    def nearest(self) -> None:
        """Search from scratch."""
        self.index.nearest(self.queries, self.matches, self.distances)

    def nearest_again(self) -> None:
        """Search with the last answers as guesses."""
        self.index.nearest(self.queries, self.matches, self.distances, self.matches)

    def update_and_nearest(self) -> None:
        """Fit the boxes to the targets' positions and search, as after every motion."""
        self.index.update(self.targets)
        self.nearest()

    def rebuild_and_nearest(self) -> None:
        """Sort the targets anew and search, as once a frame."""
        self.index.rebuild(self.targets)
        self.nearest()


def measure(quick: bool, target: str = "teapot") -> list[Row]:
    """Compare CPU time with cKDTree: between two solids, and from a solid to a surface."""
    mesh = resolve_shape(target)
    ball = sample_lattice(resolve_shape("sphere"), spacing=SPACING)
    solid = sample_lattice(mesh, spacing=SPACING)
    surface, _ = trimesh.sample.sample_surface(
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), SURFACE_COUNT, seed=42
    )
    rng = np.random.default_rng(42)
    settled = solid[np.sort(rng.integers(0, len(solid), len(ball)))]  # a morph near its end
    settled = settled + rng.normal(0, 0.1, ball.shape).astype(np.float32)
    return [
        *_compare("NN sphere -> solid", solid, ball, NEAR, quick),
        *_compare("NN solid -> sphere", ball, solid, NEAR, quick),
        *_compare("NN settled particles -> solid", solid, settled, None, quick),
        *_compare("NN sphere -> surface", surface.astype(np.float32), ball, FAR, quick),
    ]


def _compare(
    what: str, targets: Points, queries: Points, bar: tuple[float, float] | None, quick: bool
) -> list[Row]:
    ours, peer = EngineNeighbors(targets, queries), KdTreeNeighbors(targets, queries)
    ours.nearest()
    difference = np.abs(ours.distances.to_numpy() - peer.nearest()[0]).max()
    if not difference < TOLERANCE:
        raise AssertionError(f"{what}: distances differ from cKDTree's by {difference:.1e}")
    actions: dict[str, Callable[[], object]] = {
        "query": ours.nearest,
        "query with guesses": ours.nearest_again,
        "update + query": ours.update_and_nearest,
        "rebuild + query": ours.rebuild_and_nearest,
        "peer query": peer.nearest,
        "peer build + query": lambda: (peer.build(), peer.nearest()),
    }
    costs = interleaved(actions, QUICK_REPEATS if quick else REPEATS)
    milliseconds = {name: 1e3 * cost.cpu for name, cost in costs.items()}
    at_least, aim = bar or (None, None)
    note = f"{len(queries)} queries, {len(targets)} targets"
    rows = [
        speedup(
            f"{what}, query",
            milliseconds["query"],
            milliseconds["peer query"],
            "CPU ms",
            at_least,
            aim,
            note,
        )
    ]
    for name in ("query with guesses", "update + query", "rebuild + query"):
        other = "peer build + query" if "+" in name else "peer query"
        rows.append(speedup(f"{what}, {name}", milliseconds[name], milliseconds[other], "CPU ms"))
    return rows


if __name__ == "__main__":
    print(table(measure(False, *sys.argv[1:2])))
