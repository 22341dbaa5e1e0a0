"""The end of a run against the mesh of its target, by points that no method has seen.

Methods are given the target's lattice, and some take their particles' destinations from it. So runs
are compared by random points of the mesh and a lattice of random offset, drawn anew a second time:
what the two draws differ by is what a number owes to the points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import numpy.typing as npt

from chamfer_morph.reproduction.meshes import MeshFolder
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.store import Record, Store
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.point_cloud import finite_points
from morph_engine.geometry.shapes import resolve_shape
from morph_engine.geometry.surface_reconstruction import reconstruct_surface
from morph_engine.metrics.independent import Reference, surface_metrics

SEEDS = (1, 2)
"""One for each draw."""

POINTS = 100_000
"""Random points of the volume; points of the lattice are about as many."""

SURFACE_POINTS = 150_000
"""Random points of either surface."""

LEVEL_SAMPLES = 400_000
"""Most random points that the overlap with the mesh is taken over."""

SETS = 4
"""Of random points in a draw, over which s→t is taken."""

MORE_SETS = 16
"""In place of these where the draws' s→t differ by more than `AGREEMENT`."""

AGREEMENT = 0.01
"""Largest difference of s→t between draws that is left as it is, over their mean."""


def with_ends(
    runs: Sequence[Run],
    records: Mapping[str, Record],
    store: Store,
    meshes: MeshFolder,
    *,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Record]:
    """Records with the ends of these runs, measured and kept in the store where they lack them.

    A run whose result file is gone keeps the ends that it has, if any.

    Args:
        runs: The runs.
        records: Records by the ids of their runs.
        store: Has the results.
        meshes: Has the targets.
        on_progress: Called with the number of ends measured and to be measured.

    Raises:
        MorphError: A mesh is missing, a result damaged, or the disk refuses.
    """
    found = dict(records)
    lacking = [run for run in runs if _lacks_ends(run, found, store)]
    lacking.sort(key=lambda run: run.target)  # so that points are drawn once a target
    for done, run in enumerate(lacking):
        on_progress(done, len(lacking))
        with store.trajectory(run) as result:
            ends = measure_end(result.positions(-1), meshes.locate(run.target))
        found[run.id] = found[run.id].model_copy(update={"ends": ends})
        store.save(found[run.id])
    if lacking:
        on_progress(len(lacking), len(lacking))
    return found


def _lacks_ends(run: Run, records: Mapping[str, Record], store: Store) -> bool:
    record = records.get(run.id)
    if record is None or not record.is_complete or record.ends:
        return False
    return store.result_path(run).is_file()


def measure_end(positions: npt.ArrayLike, target: str) -> list[dict[str, float]]:
    """Measure particles against a mesh in grid units, by each draw.

    The spacing of as many particles in the mesh's volume is that of an even fill, whatever the
    method: it gives the body its radius and the surface its resolution.

    Args:
        positions: Of all particles [dx], shape [n, 3].
        target: What the engine is to open for the target.
    """
    points, _ = finite_points(positions)
    mesh, references = _references(target, SETS)
    spacing = references[0].spacing(len(points))
    surface = reconstruct_surface(points, spacing)
    ends = [
        reference.measure(points, spacing)
        | surface_metrics(surface, mesh, sample_count=SURFACE_POINTS, seed=seed)
        for reference, seed in zip(references, SEEDS, strict=True)
    ]
    one, other = (end["dense_s2t"] for end in ends)
    if abs(one - other) > AGREEMENT * (one + other) / 2:
        for end, reference in zip(ends, _references(target, MORE_SETS)[1], strict=True):
            end["dense_s2t"] = reference.distance_to_mesh(points)
    return ends


@lru_cache(maxsize=2)
def _references(target: str, sets: int) -> tuple[Mesh, tuple[Reference, ...]]:
    mesh = resolve_shape(target)
    return mesh, tuple(
        Reference(mesh, count=POINTS, seed=seed, sets=sets, level_samples=LEVEL_SAMPLES)
        for seed in SEEDS
    )
