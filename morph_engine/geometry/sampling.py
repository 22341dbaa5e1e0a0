"""From a mesh to particles: lattice sampling and the fit to the domain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt

from morph_engine.errors import MeshError
from morph_engine.geometry import rotation as rotations
from morph_engine.geometry.mesh import TEXT_PREFIX, Mesh
from morph_engine.geometry.rotation import Quaternion
from morph_engine.geometry.winding_number import inside

igl: Any = lazy.load("igl")

Jitter = Literal["published", "none"]
Fit = Literal["auto", "volume", "extent", "none"]
Floats = npt.NDArray[np.float64]

HALF_EXTENT = 16.0
"""Half edge of the usual domain, beyond which no mesh may reach [grid units]."""

SAFE_HALF_EXTENT = 14.0
"""Half edge of the cube [grid units] in which every particle has its full 64-node stencil."""

FIT_HALF_EXTENT = 13.0
"""Half edge [grid units] of the cube that meshes are fitted to, with room for some motion."""

REFERENCE_VOLUME = 1394.26
"""Volume [grid units^3] of the paper's sphere, which `fit_to_domain` gives to other meshes."""

PUBLISHED_SEED = 42
MINIMUM_PARTICLES = 500
"""Fewer particles than this describe no shape."""

LATTICE_LIMIT = 50_000_000
"""Most lattice points a mesh may ask for; the usual domain at 8 points per cell edge has 17 M."""

FIT_REMEDY = "To have it scaled and centred, set `sampling.fit` to auto or volume."
"""Remedy for a mesh that is too large or too small."""

TEXT_REMEDY = "Use fewer letters: texts are not scaled."
"""The same for a text."""

CHUNK = 1 << 20
"""Lattice points tested at once; bounds the memory of sampling to about 100 MB."""


def sample_lattice(
    mesh: Mesh,
    *,
    spacing: float,
    jitter: Jitter = "published",
    seed: int = PUBLISHED_SEED,
    minimum_count: int = MINIMUM_PARTICLES,
) -> npt.NDArray[np.float32]:
    """Fill a mesh with a cubic lattice of particles (algorithm 1.2).

    `published` repeats the authors' program to the particle: the lattice starts at the corner of
    the bounding box and each coordinate is moved by up to a tenth of the spacing. `none` is the
    even filling: no jitter, and the lattice centred in the bounding box.

    Args:
        mesh: Mesh in grid units.
        spacing: Distance of neighbouring lattice points [grid units].
        jitter: `published` or `none`.
        seed: Seed of the jitter; the published counts need the default.
        minimum_count: Fewest particles to accept.

    Returns:
        Particle positions [grid units], shape [n, 3], float32, in lattice order (z fastest).

    Raises:
        MeshError: The lattice would be too large, or fewer than `minimum_count` points are inside.
    """
    lower, upper = mesh.bounds
    if np.prod((upper - lower) / spacing + 2) > LATTICE_LIMIT:
        raise MeshError(
            f"{mesh.name} needs a lattice of more than {LATTICE_LIMIT:,} points.",
            size_remedy(mesh.name),
        )
    lattice = (
        _published_lattice(mesh, spacing, seed)
        if jitter == "published"
        else _even_lattice(mesh, spacing)
    )
    positions = np.concatenate([p[inside(mesh, p)] for p in lattice])
    if len(positions) < minimum_count:
        raise MeshError(
            f"{mesh.name} holds only {len(positions)} particles at a spacing of {spacing:.4g} "
            f"grid units, fewer than {minimum_count}.",
            f"Raise `sampling.points_per_cell_edge`. {size_remedy(mesh.name)}",
        )
    return positions


def size_remedy(name: str) -> str:
    """What to do about a shape of this name that is too large or too small."""
    return TEXT_REMEDY if name.startswith(TEXT_PREFIX) else FIT_REMEDY


def _published_lattice(
    mesh: Mesh, spacing: float, seed: int = PUBLISHED_SEED
) -> Iterator[npt.NDArray[np.float32]]:
    """Lattice of the authors' program in its own float32 arithmetic, a chunk at a time.

    One 32-bit Mersenne twister draw per coordinate; their compiler (GCC) evaluates the three
    draws of a point from last to first, so z comes before y before x.
    """
    step = np.float32(spacing)
    reach = np.float32(0.1) * step
    lower, upper = mesh.bounds.astype(np.float32)
    shape = np.ceil((upper - lower) / step).astype(int) + 1
    twister = np.random.RandomState(seed)
    for index in _lattice_indices(shape):
        draws = twister.randint(0, 1 << 32, index.shape, dtype="uint32").astype(np.float32)
        unit = draws * np.float32(2.0**-32)
        yield lower + step * index + (2 * reach * unit - reach)[:, ::-1]


def _even_lattice(mesh: Mesh, spacing: float) -> Iterator[npt.NDArray[np.float32]]:
    """Lattice centred in the bounding box, between 0 and half a spacing inside it."""
    lower, upper = mesh.bounds
    shape = np.maximum(np.ceil((upper - lower) / spacing), 1).astype(int)
    first = (lower + upper - spacing * (shape - 1)) / 2
    for index in _lattice_indices(shape):
        yield (first + spacing * index).astype(np.float32)


def _lattice_indices(shape: npt.NDArray[np.int_]) -> Iterator[npt.NDArray[np.float32]]:
    """Index triples of a lattice, z fastest, at most `CHUNK` of them at a time."""
    total = int(np.prod(shape))
    for start in range(0, total, CHUNK):
        flat = np.arange(start, min(start + CHUNK, total))
        yield np.stack(np.unravel_index(flat, tuple(shape)), axis=1).astype(np.float32)


@dataclass(frozen=True)
class Similarity:
    """Map from user coordinates to grid units: `grid = scale * rotated(user) + offset`.

    The rotation is a unit quaternion (x, y, z, w).
    """

    scale: float = 1.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: Quaternion = rotations.IDENTITY

    def apply(self, points: npt.ArrayLike) -> Floats:
        """Map points, shape [..., 3]; returns float64 of the same shape."""
        grid: Floats = self.scale * self._rotated(points) + np.asarray(self.offset)
        return grid

    def box(self, bounds: npt.ArrayLike) -> Floats:
        """The box around a mapped box, lower and upper corner, shape [2, 3], float64."""
        if self.rotation == rotations.IDENTITY:
            return self.apply(bounds)
        lower, upper = np.asarray(bounds, np.float64)
        centre = self.apply((lower + upper) / 2)
        half = self.scale * np.abs(rotations.matrix(self.rotation)) @ ((upper - lower) / 2)
        return np.stack([centre - half, centre + half])

    def after(self, first: Similarity) -> Similarity:
        """The map that does another one and then this one."""
        if first == Similarity():
            return self  # to the bit
        x, y, z = self.apply(first.offset).tolist()
        rotation = rotations.product(self.rotation, first.rotation)
        return Similarity(self.scale * first.scale, (x, y, z), rotation)

    def inverse(self) -> Similarity:
        """Return the map from grid units back to user coordinates."""
        back = rotations.inverse(self.rotation)
        offset = Similarity(rotation=back)._rotated(self.offset)
        x, y, z = (-component / self.scale for component in offset.tolist())
        return Similarity(1.0 / self.scale, (x, y, z), back)

    def _rotated(self, points: npt.ArrayLike) -> Floats:
        rotated = np.asarray(points, np.float64)
        if self.rotation == rotations.IDENTITY:
            return rotated  # to the bit
        return rotated @ rotations.matrix(self.rotation).T

    def blended(self, other: Similarity, share: float) -> Similarity:
        """This at share 0 and another at 1.

        Between them scales go by factors, offsets by steps, and the rotation at an even pace.
        """
        if self == other:
            return self  # to the bit
        scale = self.scale ** (1 - share) * other.scale**share
        x, y, z = (
            (1 - share) * a + share * b for a, b in zip(self.offset, other.offset, strict=True)
        )
        return Similarity(scale, (x, y, z), rotations.between(self.rotation, other.rotation, share))

    def applied(self, mesh: Mesh) -> Mesh:
        """A mesh in user coordinates in grid units."""
        return replace(mesh, vertices=self.apply(mesh.vertices))

    @property
    def matrix(self) -> Floats:
        """The map as a matrix that acts on columns, shape [4, 4]."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * rotations.matrix(self.rotation)
        matrix[:3, 3] = self.offset
        return matrix


def fit_to_domain(
    mesh: Mesh, *, mode: Literal["volume", "extent", "none"] = "none"
) -> tuple[Mesh, Similarity]:
    """Scale a mesh and centre its bounding box in the domain.

    `volume` gives it the reference volume, so that source and target get about the same number
    of particles, or the largest volume that fits if it is long and thin; `extent` makes it span the
    cube; `none` keeps its coordinates.

    Args:
        mesh: Mesh in user coordinates.
        mode: `volume`, `extent` or `none`.

    Returns:
        The mesh in grid units, and the map from user coordinates to grid units.
    """
    if mode == "none":
        return mesh, Similarity()
    similarity = fitting_similarity(mesh.volume, mesh.bounds, mode=mode)
    return similarity.applied(mesh), similarity


def fitting_similarity(
    volume: float, bounds: Floats, *, mode: Fit, reach: float = FIT_HALF_EXTENT
) -> Similarity:
    """The map of `fit_to_domain` for a shape of this volume and bounding box, shape [2, 3].

    `reach` is the half edge of the cube that it is to fit [grid units].
    """
    lower, upper = bounds
    scale = 2 * reach / float((upper - lower).max())
    if mode == "volume":
        scale = min(scale, float(np.cbrt(REFERENCE_VOLUME / volume)))
    x, y, z = (-scale * (lower + upper) / 2).tolist()
    return Similarity(scale, (x, y, z))
