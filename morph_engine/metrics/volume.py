"""Floor-free numbers: how well particles fill a shape, whatever the phase of the target's lattice.

The Chamfer distance to a lattice mixes coverage with registration to the lattice (algorithm 9.1).
The numbers here see what a person sees: holes, spill and clumps (algorithm 9.2), and particles
that stick out of the target's surface. Their short definitions stand with all others in
`morph_engine.metrics.definitions.METRICS`.
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine import backend
from morph_engine.distinct import distinct
from morph_engine.geometry.point_cloud import Points, extent, finite_points, target_points
from morph_engine.geometry.winding_number import inside
from morph_engine.metrics.chamfer import COVERING_RADIUS_OVER_H

if TYPE_CHECKING:
    from morph_engine.geometry.mesh import Mesh

igl: Any = lazy.load("igl")

QUANTILES = {"rho_p01": 0.01, "rho_p05": 0.05, "rho_p50": 0.5, "rho_p95": 0.95, "rho_p99": 0.99}
MOST_PLACES = 50_000
"""Target points at which density is measured: of more, so many that are drawn at random."""

NODES_PER_POINT = 64
"""Boxes with more nodes than that are raster nodes of too few points to be kept in memory."""

AXIS_BITS = 21
"""Bits of a raster index along one axis: three of them pack into an int64."""


def fill_metrics(
    positions: npt.ArrayLike,
    target: npt.ArrayLike,
    *,
    spacing: float,
    grid_spacing: float = 1.0,
    workers: int = 1,
) -> dict[str, float]:
    """Volume overlap and evenness of a fill (algorithm 9.2).

    With R(S) the nodes of a raster of step dx/4 that lie closer than 0.87 h to a point of S,
    A = R(particles) and B = R(target)::

        iou = #(A n B) / #(A u B)     cover = #(A n B) / #B     spill = #(A - B) / #A
        rho_j = (particles within dx of q_j / target points within dx of q_j) / (N / M)

    A raster node sits dx, or 0.87 h if that is more, outside the least corner of the joint bounding
    box. A lattice finer than dx/4 or coarser than dx takes the step h or h/4 instead, which keeps
    the balls free of holes and the cost bounded.

    Args:
        positions: Particle positions [dx], shape [n, 3].
        target: Target points filling the volume [dx], shape [m, 3].
        spacing: Lattice spacing h of the target [dx].
        grid_spacing: Cell edge dx of the simulation grid, 1 in its own units.
        workers: Threads for the searches; -1 takes every core.

    Returns:
        ``iou``, ``cover``, ``spill`` and the 1, 5, 50, 95 and 99 % quantiles of rho over all
        target points, ``rho_p01`` to ``rho_p99``; over 50 000 of them, always the same ones, where
        there are more. Particles that are not finite, or some 10^6
        raster steps away from the target, take no part; with none left, all is 0 and spill 1.

    Raises:
        MeshError: Either array has the wrong shape, or the target is empty or not finite.
    """
    points, _ = finite_points(positions)
    goal = target_points(target)
    step = float(np.clip(grid_spacing / 4, spacing / 4, spacing))
    reach = (2 ** (AXIS_BITS - 1) - 16) * step
    least, most = extent(goal)
    near = np.abs(points - (least + most) / 2) < reach
    if not near.all():
        points = points[near.all(axis=1)]
    if not len(points):
        return {"iou": 0.0, "cover": 0.0, "spill": 1.0} | dict.fromkeys(QUANTILES, 0.0)

    radius = COVERING_RADIUS_OVER_H * spacing
    corner = np.minimum(least, extent(points)[0]) - max(grid_spacing, radius)
    filled, wanted, shared = _overlap(points, goal, corner, radius=radius, step=step)
    ratio = density_ratio(
        points, goal, places=_some(goal), radius=grid_spacing, workers=workers, spacing=spacing
    )
    quantiles = np.quantile(ratio, list(QUANTILES.values()))
    return {
        "iou": shared / (filled + wanted - shared),
        "cover": shared / wanted,
        "spill": 1 - shared / filled,
    } | dict(zip(QUANTILES, quantiles.tolist(), strict=True))


def outside_metrics(positions: npt.ArrayLike, mesh: Mesh) -> dict[str, float]:
    """How many particles stick out of the target mesh, and how far.

    A particle is outside where the generalised winding number is below 1/2, the test that made
    the target's lattice (algorithm 1.2). Its distance is to the nearest point of any triangle; at
    a hole of an open mesh this is the hole's rim, so the distance there is an upper bound.

    Args:
        positions: Particle positions [dx], shape [n, 3].
        mesh: Target mesh in grid units.

    Returns:
        ``outside_share`` of the finite particles, and ``outside_mean`` and ``outside_max`` [dx]
        over those outside, 0 if there is none. With no finite particle 1, inf and inf.

    Raises:
        MeshError: The positions have the wrong shape.
    """
    points, _ = finite_points(positions)
    if not len(points):
        return {"outside_share": 1.0, "outside_mean": math.inf, "outside_max": math.inf}
    outside = np.ascontiguousarray(points[~inside(mesh, points)])
    if not len(outside):
        return {"outside_share": 0.0, "outside_mean": 0.0, "outside_max": 0.0}
    faces = mesh.faces.astype(np.int64)
    squared, _, _ = igl.point_mesh_squared_distance(outside, mesh.vertices, faces)
    distance = np.sqrt(squared)
    return {
        "outside_share": len(outside) / len(points),
        "outside_mean": float(distance.mean()),
        "outside_max": float(distance.max()),
    }


def _overlap(
    points: Points, goal: Points, corner: Points, *, radius: float, step: float
) -> tuple[int, int, int]:
    """Number of raster nodes near particles, near the target, and near both.

    A node is near if it is closer than ``radius`` to a point; it is ``corner + step * (i, j, k)``.
    """
    most = np.maximum(extent(points)[1], extent(goal)[1])
    x, y, z = (((most - corner + radius) / step).astype(np.int64) + 2).tolist()
    if backend.runs_on_cpu() and x * y * z < NODES_PER_POINT * (len(points) + len(goal)):
        from morph_engine.metrics.raster import overlap  # which loads Taichi

        return overlap((points, goal), corner, (x, y, z), radius=radius, step=step)
    filled = _raster_nodes(points - corner, radius=radius, step=step)
    wanted = _raster_nodes(goal - corner, radius=radius, step=step)
    return filled.size, wanted.size, np.intersect1d(filled, wanted, assume_unique=True).size


def _raster_nodes(points: Points, *, radius: float, step: float) -> npt.NDArray[np.int64]:
    """Sorted keys of the raster nodes ``step * (i, j, k)`` closer than ``radius`` to a point.

    Only the few nodes around each point are looked at, so time and memory follow the number of
    points and not the size of the box around them.
    """
    place, reach = points / step, radius / step
    first = np.ceil(place - reach)
    around = first + np.arange(int(2 * reach) + 1)[:, None, None]  # node indices [offset, n, axis]
    apart = (around - place) ** 2
    key = around.astype(np.int64) << (AXIS_BITS * np.arange(3))
    found = [
        (key[i, :, 0] + key[j, :, 1] + key[k, :, 2])[
            apart[i, :, 0] + apart[j, :, 1] + apart[k, :, 2] < reach**2
        ]
        for i, j, k in product(range(len(around)), repeat=3)
    ]
    return distinct(np.concatenate(found))


def _some(goal: Points) -> Points:
    """At most `MOST_PLACES` of these points."""
    if len(goal) <= MOST_PLACES:
        return goal
    return goal[np.random.default_rng(0).choice(len(goal), MOST_PLACES, replace=False)]


def density_ratio(
    points: Points,
    goal: Points,
    *,
    places: Points | None = None,
    radius: float = 1.0,
    workers: int = 1,
    spacing: float | None = None,
) -> Points:
    """Density of particles at target points, over that of an even fill (algorithm 9.2).

    Args:
        points: Particle positions [dx], shape [n, 3], float64.
        goal: Target points [dx], shape [m, 3], float64.
        places: Those of them where it is taken [dx], shape [k, 3], float64; all if not given.
        radius: Within which both are counted [dx].
        workers: Threads for the searches; -1 takes every core.
        spacing: About how far target points are apart, if that is known [dx]: with it, counting
            takes less time where Taichi runs.

    Returns:
        rho_j: particles over target points within the radius, over N / M; shape [k], float64.
    """
    at = goal if places is None else places
    here, wanted = _counts_within(points, goal, at, radius, workers, spacing)
    ratio: Points = (here / wanted) * (len(goal) / len(points))
    return ratio


def _counts_within(
    points: Points,
    goal: Points,
    places: Points,
    radius: float,
    workers: int,
    spacing: float | None,
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Number of particles, and of target points, within the radius of some places."""
    if spacing is not None and backend.runs_on_cpu():
        single = [cloud.astype(np.float32) for cloud in (points, goal)]
        if (single[0] == points).all() and (single[1] == goal).all():
            from morph_engine.metrics.ball_counts import BallCounts  # which loads Taichi

            apart = spacing * float(np.cbrt(len(goal) / len(places)))
            counts = BallCounts(places.astype(np.float32), apart, radius)
            if counts.possible:
                return counts.of(single[0]), counts.of(single[1])
    here, wanted = (
        scipy.spatial.cKDTree(cloud).query_ball_point(
            places, radius, return_length=True, workers=workers
        )
        for cloud in (points, goal)
    )
    return here, wanted
