"""Measure any two shapes against each other: meshes, point clouds, results, or their files.

Each is brought to points first: a mesh by the lattice that fills it (reference ``volume``) or by
samples of its surface (reference ``surface``), a result by one of its frames. Numbers against
the two references are not comparable, so the reference is kept with them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import numpy.typing as npt
import trimesh

from morph_engine.errors import ConfigError, MeshError, ResultError
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.point_cloud import Points
from morph_engine.geometry.sampling import SAFE_HALF_EXTENT, sample_lattice
from morph_engine.geometry.shapes import resolve_shape
from morph_engine.geometry.surface_reconstruction import reconstruct_surface
from morph_engine.geometry.topology import triangle_areas
from morph_engine.metrics.chamfer import chamfer_metrics
from morph_engine.metrics.independent import mesh_metrics, surface_metrics
from morph_engine.metrics.path import path_metrics
from morph_engine.metrics.volume import fill_metrics, outside_metrics
from morph_engine.results.trajectory import Trajectory, opened

Reference = Literal["volume", "surface"]
Comparable = Mesh | Trajectory | str | Path | npt.ArrayLike

Matrix = npt.NDArray[np.floating[Any]]

DEFAULT_SPACING = 1 / 3
"""Lattice spacing [dx] of the paper's main resolution, three points per cell edge."""


@dataclass(frozen=True)
class Measurement:
    """Numbers, and what they were measured against.

    Attributes:
        values: Metric name to value, in the order and meaning of `metrics.METRICS`.
        reference: What the target points are: ``volume`` (they fill it) or ``surface``.
        particle_count: Number of particles, lost ones included.
        target_count: Number of target points.
        spacing: Spacing h of the target points [dx].
        tau: Threshold of precision, recall and F1 [dx].
    """

    values: Mapping[str, float]
    reference: Reference
    particle_count: int
    target_count: int
    spacing: float
    tau: float

    def document(self) -> dict[str, Any]:
        """All of it as one flat JSON object; a distance may be infinite."""
        document = asdict(self)
        values = document.pop("values")
        return {**document, **values}


def compare(
    a: Comparable,
    b: Comparable | None = None,
    *,
    spacing: float | None = None,
    reference: Reference = "volume",
    frame: int = -1,
    tau: float = 0.2,
    sample_count: int = 80_000,
    workers: int = 1,
) -> Measurement:
    """Measure one shape as the particles against another as the target.

    A mesh or cloud that is compared with a result is first brought to that run's grid units, as the
    frame lies in the user's coordinates; the meshes of its source and target as the run has placed
    them. So the numbers are those of the run.

    Args:
        a: The particles: a mesh, a result, an array of points [n, 3], the file of one of these
            (.vtkhdf; .npy, .csv, .txt, .xyz, .ply without faces; any mesh format), or the name
            of a built-in shape.
        b: The target, the same kinds; may be left out if `a` is a result, which has its own.
        spacing: Lattice spacing h [dx]. Not given: that of the result, or 1/3; for the samples of
            a surface, the square root of its area per sample.
        reference: Fill meshes with a lattice (``volume``) or sample their ``surface``.
        frame: Frame of a result, negative from the end.
        tau: Threshold of precision, recall and F1 [dx], strict.
        sample_count: Number of samples of a surface.
        workers: Threads for the searches; -1 takes every core.

    Returns:
        The numbers of `chamfer_metrics`, those of `fill_metrics` against a volume, and of
        `outside_metrics` if the target is a mesh.

    Raises:
        MeshError: A shape cannot be read or used, or has no lattice point at this spacing.
        ResultError: A result cannot be read or has no such frame.
        ConfigError: The spacing is not a positive length.
    """
    if spacing is not None and not 0 < spacing < math.inf:
        raise ConfigError(f"The spacing {spacing} is not valid.", "Give a spacing above 0.")
    particles = _load(a, frame)
    goal = _own_target(particles, reference) if b is None else _load(b, frame)
    if b is not None:
        particles, goal = _in_grid_units(particles, goal), _in_grid_units(goal, particles)
    if spacing is None and reference == "surface" and goal.mesh is not None:
        spacing = math.sqrt(
            triangle_areas(goal.mesh.vertices, goal.mesh.faces).sum() / sample_count
        )
    spacing = spacing or particles.spacing or goal.spacing or DEFAULT_SPACING

    def cloud(shape: _Shape) -> npt.NDArray[Any]:
        if shape.points is not None:
            return shape.points
        assert shape.mesh is not None
        if reference == "surface":
            return sample_surface(shape.mesh, count=sample_count, seed=0)
        return _fill(shape.mesh, spacing)

    positions, target = cloud(particles), cloud(goal)
    values = chamfer_metrics(
        positions,
        target,
        spacing=spacing,
        tau=tau,
        domain_half_extent=particles.domain or goal.domain or SAFE_HALF_EXTENT,
        workers=workers,
    )
    if reference == "volume":
        values |= fill_metrics(positions, target, spacing=spacing, workers=workers)
    if goal.mesh is not None:
        values |= outside_metrics(positions, goal.mesh)
    return Measurement(values, reference, len(positions), len(target), spacing, tau)


def measure_path(result: Trajectory | str | Path, leg: int = 0) -> dict[str, float]:
    """Measure the path of a result, and its end against the target's mesh.

    h of a frame is the spacing of as many particles in a volume that goes linearly from that of the
    source to that of the target, along the schedule of the method.

    Args:
        result: The result, or its file.
        leg: Of a morph through several shapes, from 0.

    Returns:
        The numbers of `path_metrics`, with the source as the first frame; those of `mesh_metrics`
        and `surface_metrics` if the target is a mesh.

    Raises:
        ResultError: The result cannot be read, or has no frame of this leg.
    """
    with opened(result) as run:
        own = np.flatnonzero(run.legs == leg)
        if not len(own):
            raise ResultError(
                f"There is no frame of leg {leg}.",
                f"Its legs are numbered from 0 to {run.run.leg_count - 1}.",
            )
        places = [run.positions(int(frame)) for frame in own]
        record = run.run.leg(leg, run.positions(int(own[0]) - 1) if leg else None)
        frames = [record.source_points, *places]
        corrections = run.metrics.get("correction")
        det_f = run.det_f(int(own[-1])) if leg == 0 else None  # F begins with the first leg
    share_of_change = record.config.method.share_of_change
    shares = np.array([share_of_change(k, record.config.frames) for k in range(len(frames))])
    apart = record.config.spacing * np.cbrt(1 - shares + shares * record.ratio)
    settled = None
    if corrections is not None:  # on average over the particles of each frame
        settled = np.full(record.particle_count, corrections[own].sum())
    values = path_metrics(frames, apart, shares=shares / shares[-1], settled=settled, det_f=det_f)
    mesh, _ = record.fitted("target")
    if mesh is not None:
        last, spacing = frames[-1], float(apart[-1])
        values |= mesh_metrics(last, mesh, spacing)
        values |= surface_metrics(reconstruct_surface(last, spacing), mesh)
    return values


def sample_surface(mesh: Mesh, *, count: int, seed: int) -> Points:
    """Draw points from a mesh's surface, uniformly by area, shape [count, 3], float64."""
    rng = np.random.default_rng(seed)
    area = triangle_areas(mesh.vertices, mesh.faces)
    drawn = mesh.faces[rng.choice(len(area), count, p=area / area.sum())]
    corner, first, second = np.moveaxis(mesh.vertices[drawn], 1, 0)
    # uniform in the unit square, folded along its diagonal onto the triangle
    u, v = rng.uniform(size=(2, count, 1))
    u, v = np.where(u + v > 1, (1 - u, 1 - v), (u, v))
    points: Points = corner + u * (first - corner) + v * (second - corner)
    return points


@dataclass(frozen=True)
class _Shape:
    """One side of a comparison: known points, or a mesh to take them from, or both."""

    points: npt.NDArray[Any] | None = None
    mesh: Mesh | None = None
    # of a result only
    to_user: Matrix | None = None  # of its frame
    placed: tuple[tuple[object, Matrix], ...] = ()  # the shapes at its ends, and how they lie
    spacing: float | None = None
    domain: float | None = None
    target: _Shape | None = None

    def moved(self, matrix: Matrix) -> _Shape:
        """The shape under an affine map, shape [4, 4], that acts on columns."""

        def move(points: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
            moved: npt.NDArray[np.float64] = points @ matrix[:3, :3].T + matrix[:3, 3]
            return moved

        return replace(
            self,
            points=None if self.points is None else move(self.points),
            mesh=self.mesh and replace(self.mesh, vertices=move(self.mesh.vertices)),
        )


def _load(shape: Comparable, frame: int) -> _Shape:
    if isinstance(shape, Trajectory):
        return _of_run(shape, frame)
    if isinstance(shape, Mesh):
        return _Shape(mesh=shape)
    if not isinstance(shape, str | Path):
        return _Shape(points=np.asarray(shape))
    path = Path(shape)
    suffix = path.suffix.lower()
    if suffix == ".vtkhdf" or h5py.is_hdf5(path):
        with Trajectory(path) as run:
            return _of_run(run, frame)
    if suffix in (".npy", ".csv", ".txt", ".xyz") or (suffix == ".ply" and _is_bare_cloud(path)):
        return _Shape(points=_load_points(path))
    return _Shape(mesh=resolve_shape(str(shape)))


def _of_run(run: Trajectory, frame: int) -> _Shape:
    leg = run.run.leg(run.leg_of(frame))
    target = _Shape(mesh=leg.target) if isinstance(leg.target, Mesh) else _Shape()
    target = replace(target.moved(np.linalg.inv(leg.transform)), points=leg.target_points)
    return _Shape(
        points=run.positions(frame),
        to_user=run.transform_at(frame),
        placed=(
            (leg.source, leg.transform_to("source", 0)),
            (leg.target, leg.transform_to("target", 1)),
        ),
        spacing=leg.config.spacing,
        domain=leg.config.domain,
        target=target,
    )


def _in_grid_units(shape: _Shape, other: _Shape) -> _Shape:
    """A shape in user coordinates, brought to the grid of the run it is compared with."""
    if shape.to_user is not None or other.to_user is None:
        return shape
    to_user = other.to_user
    for mesh, placed in other.placed:
        if _are_equal(shape.mesh, mesh):
            to_user = placed
    return shape.moved(np.linalg.inv(to_user))


def _are_equal(mesh: Mesh | None, other: object) -> bool:
    return (
        mesh is not None
        and isinstance(other, Mesh)
        and np.array_equal(mesh.vertices, other.vertices)
        and np.array_equal(mesh.faces, other.faces)
    )


def _own_target(particles: _Shape, reference: Reference) -> _Shape:
    if particles.target is None:
        raise MeshError("There is nothing to compare with.", "Name a second shape as the target.")
    if reference == "volume":
        return particles.target
    if particles.target.mesh is None:
        raise MeshError(
            "The target of the run is a point cloud without a surface.",
            "Measure against the volume.",
        )
    return replace(particles.target, points=None)


def _fill(mesh: Mesh, spacing: float) -> npt.NDArray[np.float32]:
    try:
        return sample_lattice(mesh, spacing=spacing, minimum_count=1)
    except MeshError as error:  # its remedies are those of a run
        remedy = "Change the lattice spacing (`points_per_cell_edge`), or scale both shapes."
        raise MeshError(error.cause, remedy) from error


def _is_bare_cloud(path: Path) -> bool:
    """Tell whether a PLY file announces no faces."""
    try:
        with path.open("rb") as file:
            header = file.read(4096).split(b"end_header")[0]
    except OSError:
        return False  # the mesh loader has the message
    return not any(
        line.split()[:2] == [b"element", b"face"] and line.split()[2:] != [b"0"]
        for line in header.splitlines()
    )


def _load_points(path: Path) -> npt.NDArray[Any]:
    """Read a point cloud from a file, shape [n, 3]."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty file; its emptiness is reported later
            match path.suffix.lower():
                case ".npy":
                    points = np.load(path, allow_pickle=False)
                case ".ply":
                    cloud: Any = trimesh.load(path, process=False)
                    points = cloud.vertices
                case suffix:
                    comma = "," if suffix == ".csv" else None
                    points = np.loadtxt(path, delimiter=comma, usecols=(0, 1, 2), ndmin=2)
        return np.asarray(points, np.float64)
    except (OSError, EOFError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise MeshError(
            f"{path} cannot be read as a point cloud ({error}).",
            "Give a file with three numbers x, y, z per point.",
        ) from error
