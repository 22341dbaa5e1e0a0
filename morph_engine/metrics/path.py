"""How a morph moves, from particle positions alone, whatever the method.

Frames hold the same particles in the same order. `docs/metrics.md` has the definitions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.geometry.point_cloud import Points, farthest_points
from morph_engine.geometry.surface_reconstruction import surface_euler
from morph_engine.metrics.body import count_pieces, measure_body
from morph_engine.metrics.chamfer import COVERING_RADIUS_OVER_H
from morph_engine.metrics.definitions import METRICS

NEIGHBORS = 12
NODE_CELL_OVER_H = 2.0
"""Edge of the cells of which each gives one node to the graph of shortest paths."""

EDGE_OVER_H = 5.0
"""Longest edge of that graph: some 65 edges a node, with lengths within 2 % of the distance."""


INSIDE_OVER_H = 2.5
"""Radius of the kernel of local volumes: some 65 particles."""

OFF_CENTRE = 0.04
"""Particles count as inside where the centre of their neighbours is so near, over that radius."""

BODIES = 9
"""Frames of a path, evenly spaced, of which the body is measured."""

OF_ALL_PATHS = (
    "area_min", "area_max", "volume_min", "volume_max", "more_pieces", "more_euler", "d2_min",
    "kept", "gap_p01", "gap_min", "geodesic", "detour", "action",
)  # fmt: skip
"""Metrics that need nothing but positions."""


def path_metrics(
    frames: Sequence[npt.ArrayLike],
    spacing: npt.ArrayLike,
    *,
    shares: npt.ArrayLike | None = None,
    settled: npt.ArrayLike | None = None,
    det_f: npt.ArrayLike | None = None,
) -> dict[str, float]:
    """Measure a path, by the worst of its frames where a number is one of a frame.

    Area, volume and Euler number are taken in 9 evenly spaced frames, everything else in all.

    Args:
        frames: Particle positions of each frame [dx], shape [n, 3] each, the source first.
            Particles that are not finite in all of them take no part. If no more than 12 are left,
            too few for neighbours, every number has its worst value.
        spacing: Lattice spacing h [dx]; or of each frame, where particles end farther apart or
            closer, shape [frames].
        shares: Share of the change at each frame, 0 to 1, for methods that ease or rest, shape
            [frames]; even steps when not given.
        settled: Length of the moves that the simulation did not make [dx], shape [n].
        det_f: det F of the particles in the last frame [ratio], shape [n].

    Returns:
        ``area_min``, ``area_max``, ``volume_min``, ``volume_max``, ``more_pieces``, ``more_euler``
        and the numbers of `neighbor_metrics`, `gap_metrics`, `geodesic_distortion` and
        `motion_metrics`; ``settled`` and the numbers of `volume_metrics` if these are given.
        `METRICS` defines them.
    """
    finite = np.all([np.isfinite(frame).all(axis=1) for frame in frames], axis=0)
    if np.count_nonzero(finite) <= NEIGHBORS:
        given = () if settled is None else ("settled",)
        return {name: METRICS[name].worst for name in (*OF_ALL_PATHS, *given)}
    places = [np.asarray(frame, np.float64)[finite] for frame in frames]
    chosen = np.unique(np.linspace(0, len(places) - 1, BODIES).round().astype(int))
    share = np.linspace(0, 1, len(places)) if shares is None else np.asarray(shares, np.float64)
    h = np.broadcast_to(np.asarray(spacing, np.float64), len(places))
    bodies = [measure_body(places[i], h[i]) for i in chosen]
    area = over_schedule([body.area for body in bodies], share[chosen])
    volume = over_schedule([body.volume for body in bodies], share[chosen])
    gaps = [gap_metrics(frame, apart) for frame, apart in zip(places, h, strict=True)]
    pieces = [count_pieces(frame, apart) for frame, apart in zip(places, h, strict=True)]
    values = {
        "area_min": float(area.min()),
        "area_max": float(area.max()),
        "volume_min": float(volume.min()),
        "volume_max": float(volume.max()),
        "more_pieces": float(max(pieces) - max(pieces[0], pieces[-1])),
        "more_euler": _beyond_ends([surface_euler(places[i], h[i]) for i in chosen]),
        **neighbor_metrics(places[0], places[-1], h[0]),
        **{name: min(gap[name] for gap in gaps) for name in gaps[0]},
        "geodesic": geodesic_distortion(places[0], places[-1], h[0]),
        **motion_metrics(places),
    }
    if settled is not None:
        values["settled"] = settled_share(places, np.asarray(settled)[finite])
    if det_f is not None:
        ends = float(h[0]), float(h[-1])
        values |= volume_metrics(places[0], places[-1], np.asarray(det_f)[finite], ends)
    return values


def over_schedule(
    values: npt.ArrayLike, shares: npt.ArrayLike | None = None
) -> npt.NDArray[np.float64]:
    """Values of frames over their schedule, shape [frames], float64.

    The schedule runs linearly from the first value to the last: over the frame index, or over the
    shares of the change (0 to 1, shape [frames]) of a method that eases or rests.
    """
    series = np.asarray(values, np.float64)
    share = np.linspace(0, 1, len(series)) if shares is None else np.asarray(shares, np.float64)
    ratio: npt.NDArray[np.float64] = series / ((1 - share) * series[0] + share * series[-1])
    return ratio


def neighbor_metrics(first: npt.ArrayLike, last: npt.ArrayLike, spacing: float) -> dict[str, float]:
    """How the 12 nearest neighbours of each particle fare from the first frame to the last.

    Args:
        first: Particle positions [dx], shape [n, 3], n > 12.
        last: The same particles later [dx], shape [n, 3].
        spacing: Lattice spacing h [dx].

    Returns:
        ``d2_min`` [h^2]: mean over particles of the mean squared residual of the best affine map
        of the neighbours' places relative to the particle (Falk and Langer 1998). ``kept``: share
        of the neighbours that are among the 12 nearest at the end.
    """
    start, end = np.asarray(first, np.float64), np.asarray(last, np.float64)
    before, after = _nearest(start, NEIGHBORS), _nearest(end, NEIGHBORS)
    rest, moved = start[before] - start[:, None], end[before] - end[:, None]
    turned = rest.swapaxes(1, 2)
    affine = np.linalg.pinv(turned @ rest, hermitian=True) @ (turned @ moved)
    residual = ((moved - rest @ affine) ** 2).sum(axis=2)
    kept = (before[:, :, None] == after[:, None, :]).any(axis=2)
    return {"d2_min": float(residual.mean() / spacing**2), "kept": float(kept.mean())}


def volume_metrics(
    first: npt.ArrayLike,
    last: npt.ArrayLike,
    det_f: npt.ArrayLike,
    spacings: tuple[float, float],
    *,
    sample_count: int = 3000,
) -> dict[str, float]:
    """What positions say of local volumes, beside what the deformation gradients say.

    The volume around a particle goes as 1 / rho, with rho = sum_q (1 - r^2 / R^2)^2 / R^3 over all
    particles q at distances r below R = 2.5 h; det F is averaged over the same ones. Near a surface
    rho says nothing, so only particles inside count.

    Args:
        first: Particle positions [dx], shape [n, 3].
        last: The same particles later [dx], shape [n, 3].
        det_f: Their det F then [ratio], shape [n].
        spacings: Lattice spacing h of both [dx].
        sample_count: Particles that are looked at.

    Returns:
        ``local_volume``: median of rho_0 / rho_1 over (h_1 / h_0)^3. ``det_f_off``: mean of
        abs(mean det F * rho_1 / rho_0 - 1). Neither where no particle is inside in both.
    """
    frames = [np.asarray(frame, np.float64) for frame in (first, last)]
    ratios = np.asarray(det_f, np.float64)
    count = len(ratios)
    chosen = np.random.default_rng(0).permutation(count)[:sample_count]
    density, off_centre = np.empty((2, len(chosen))), np.empty((2, len(chosen)))
    around: list[list[int]] = []
    for side, (points, h) in enumerate(zip(frames, spacings, strict=True)):
        reach = INSIDE_OVER_H * h
        around = scipy.spatial.cKDTree(points).query_ball_point(points[chosen], reach)
        for place, (p, near) in enumerate(zip(chosen, around, strict=True)):
            away = (points[near] - points[p]) / reach
            weight = np.maximum(1 - (away**2).sum(axis=1), 0) ** 2
            density[side, place] = weight.sum() / reach**3
            off_centre[side, place] = np.linalg.norm(weight @ away) / weight.sum()
    inside = (off_centre < OFF_CENTRE).all(axis=0)
    if not inside.any():
        return {}
    volume = (density[0] / density[1])[inside]
    gradient = np.array([ratios[near].mean() for near in around])[inside]
    return {
        "local_volume": float(np.median(volume) * (spacings[0] / spacings[1]) ** 3),
        "det_f_off": float(np.abs(gradient / volume - 1).mean()),
    }


def gap_metrics(positions: npt.ArrayLike, spacing: float) -> dict[str, float]:
    """``gap_p01`` and ``gap_min`` [h]: 1 % quantile and least of the distance to the nearest other.

    Args:
        positions: Particle positions [dx], shape [n, 3], n > 1.
        spacing: Lattice spacing h [dx].
    """
    points = np.asarray(positions, np.float64)
    gap = scipy.spatial.cKDTree(points).query(points, k=[2])[0][:, 0] / spacing
    return {"gap_p01": float(np.quantile(gap, 0.01)), "gap_min": float(gap.min())}


def motion_metrics(frames: Sequence[npt.ArrayLike]) -> dict[str, float]:
    """How directly the particles move, whatever the timing.

    Args:
        frames: Particle positions of each frame [dx], shape [n, 3] each.

    Returns:
        ``detour``: sum of the lengths of all paths over the sum of the straight distances.
        ``action``: kinetic action over that of straight lines, both with the best timing that all
        particles share: (sum over steps of the rms step)^2 / mean squared distance. Both are 1
        where all particles move along straight lines with a common timing, and also where
        nothing moves.
    """
    places = [np.asarray(frame, np.float64) for frame in frames]
    steps = np.stack([((b - a) ** 2).sum(axis=1) for a, b in pairwise(places)])
    straight = ((places[-1] - places[0]) ** 2).sum(axis=1)
    if not steps.any():
        return {"detour": 1.0, "action": 1.0}
    with np.errstate(divide="ignore"):
        return {
            "detour": float(np.sqrt(steps).sum() / np.sqrt(straight).sum()),
            "action": float(np.sqrt(steps.mean(axis=1)).sum() ** 2 / straight.mean()),
        }


def settled_share(frames: Sequence[npt.ArrayLike], settled: npt.ArrayLike) -> float:
    """Share of the motion that the simulation did not make.

    Args:
        frames: Particle positions of each frame [dx], shape [n, 3] each.
        settled: Length of the moves made beyond the simulation by each particle [dx], shape [n].
    """
    places = [np.asarray(frame, np.float64) for frame in frames]
    length = sum(float(np.linalg.norm(b - a, axis=1).sum()) for a, b in pairwise(places))
    return float(np.sum(settled)) / length if length else 0.0


def geodesic_distortion(
    first: npt.ArrayLike, last: npt.ArrayLike, spacing: float, *, landmark_count: int = 300
) -> float:
    """Change of shortest paths inside the body: rms difference over mean.

    Paths are among farthest-point landmarks, over a graph of one particle per cell of 2 h whose
    edges, up to 5 h long, stay inside the body. Pairs that are in different pieces of either body
    take no part.

    Args:
        first: Particle positions [dx], shape [n, 3].
        last: The same particles later [dx], shape [n, 3].
        spacing: Lattice spacing h [dx].
        landmark_count: Number of landmarks.
    """
    start, end = np.asarray(first, np.float64), np.asarray(last, np.float64)
    chosen = farthest_points(start, landmark_count)
    before, after = (shortest_paths(points, chosen, spacing) for points in (start, end))
    both = np.isfinite(before) & np.isfinite(after) & (before > 0)
    mean = before[both].mean()
    return float(np.sqrt(np.mean((after[both] - before[both]) ** 2)) / mean)


def part_transfer(
    start_labels: npt.ArrayLike,
    last: npt.ArrayLike,
    label_at: Callable[[Points], npt.NDArray[np.integer]],
) -> dict[int, float]:
    """Share of each part's matter that ends in the like part of the target.

    Args:
        start_labels: Part in which each particle starts, shape [n], integer; those below 0 belong
            to none.
        last: Where it ends [dx], shape [n, 3].
        label_at: Part of the target at points [k, 3], shape [k], integer.
    """
    labels = np.asarray(start_labels)
    arrived = label_at(np.asarray(last, np.float64)) == labels
    return {int(a): float(arrived[labels == a].mean()) for a in np.unique(labels[labels >= 0])}


def nearest_labels(
    points: Points, labels: npt.ArrayLike
) -> Callable[[Points], npt.NDArray[np.integer]]:
    """Labels of a space of which some points [k, 3] are labelled: that of the nearest one."""
    tree, known = scipy.spatial.cKDTree(points), np.asarray(labels, np.int64)

    def label_at(queries: Points) -> npt.NDArray[np.integer]:
        found: npt.NDArray[np.integer] = known[tree.query(queries)[1]]
        return found

    return label_at


def _beyond_ends(counts: Sequence[int]) -> float:
    """How far any count is outside the range of the first and the last."""
    low, high = sorted((counts[0], counts[-1]))
    return float(max(max(counts) - high, low - min(counts)))


def _nearest(points: Points, count: int) -> npt.NDArray[np.intp]:
    """Indices of the nearest other points, shape [n, count], whatever coincides."""
    found = scipy.spatial.cKDTree(points).query(points, k=count + 1)[1]
    own = found == np.arange(len(points))[:, None]
    own[~own.any(axis=1), -1] = True
    others: npt.NDArray[np.intp] = found[~own].reshape(len(points), count)
    return others


def shortest_paths(
    points: Points, landmarks: npt.NDArray[np.intp], spacing: float
) -> npt.NDArray[np.float64]:
    """Shortest paths inside a body between some of its particles.

    Args:
        points: Particle positions [dx], shape [n, 3].
        landmarks: Indices of those between which paths are measured, shape [k].
        spacing: Lattice spacing h [dx].

    Returns:
        Lengths of the paths [dx], shape [k, k]; inf between pieces.
    """
    cell = np.floor(points / (NODE_CELL_OVER_H * spacing)).astype(np.int64)
    off_centre = ((points / (NODE_CELL_OVER_H * spacing) - cell - 0.5) ** 2).sum(axis=1)
    order = np.argsort(off_centre, kind="stable")
    central = order[np.unique(cell[order], axis=0, return_index=True)[1]]
    nodes = np.concatenate([landmarks, np.setdiff1d(central, landmarks)])
    places = points[nodes]

    edges = scipy.spatial.cKDTree(places).query_pairs(EDGE_OVER_H * spacing, output_type="ndarray")
    a, b = places[edges[:, 0]], places[edges[:, 1]]
    length = np.linalg.norm(b - a, axis=1)
    tree = scipy.spatial.cKDTree(points)
    inside = np.ones(len(edges), bool)
    stops = int(EDGE_OVER_H)
    for share in np.arange(1, stops) / stops:
        passed = a[inside] + share * (b - a)[inside]
        reach = tree.query(passed, distance_upper_bound=COVERING_RADIUS_OVER_H * spacing)[0]
        inside[inside] = np.isfinite(reach)
    edges, length = edges[inside], np.maximum(length[inside], 1e-12)
    graph = scipy.sparse.coo_array(
        (length, (edges[:, 0], edges[:, 1])), shape=(len(nodes),) * 2
    ).tocsr()
    count = len(landmarks)
    paths: npt.NDArray[np.float64] = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=np.arange(count)
    )[:, :count]
    return paths
