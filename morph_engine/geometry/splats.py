"""A solid from Gaussian splats: the surface around a cloud of soft, coloured ellipsoids.

Captured splats lie in a thin shell, and those of a filled body everywhere in it. Either way the
cells of a raster that they reach are closed and filled, and a surface is put around them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine.errors import MeshError
from morph_engine.geometry.mesh_colors import MeshColors

igl: Any = lazy.load("igl")

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

NAMES = ("opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)))
"""Properties of a vertex in a PLY file of splats (Kerbl et al. 2023)."""

HARMONIC = 0.5 / np.sqrt(np.pi)
"""Y_00, the spherical harmonic of degree 0, by which a colour is stored."""

LEAST_OPACITY = 0.1
"""Splats that hide less than this are haze."""

OUTERMOST = 1e-3
"""Share of the splats, from either end and along each axis, that may be stray."""

STRAY = 0.25
"""Those farther from the rest than this part of its extent are."""

CELLS = 160
"""Cells of the raster along the longest side."""

GAPS = (2, 4, 8)
"""Half the width of the gaps that are closed, the first that leaves the shell tight [cells]."""

DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
"""From the middle of a cube to its faces, edges and corners: where splats are looked for."""

MARGIN = GAPS[-1] + 2
"""Empty cells around the solid."""

SMOOTHING = 1.0
"""Width of the Gaussian that takes the steps of the raster away [cells]."""

ISO_LEVEL = 0.69
"""Level of the surface, half a cell inside that of 0.5: cells count that are reached in part."""


def are_splats(names: npt.ArrayLike) -> bool:
    """Whether the properties of a PLY file's vertices are those of splats."""
    return set(NAMES) <= set(np.asarray(names).tolist())


def solid_of_splats(
    vertices: Mapping[str, npt.NDArray[np.floating]],
) -> tuple[Floats, npt.NDArray[np.int32], MeshColors | None]:
    """The closed surface around splats, and its colours.

    Args:
        vertices: Properties of the splats by name, each of shape [n].

    Returns:
        Corners, shape [v, 3], triangles, shape [f, 3], and colours if the splats have any.

    Raises:
        MeshError: They enclose nothing.
    """
    values = {name: np.asarray(vertices[name], np.float64) for name in ("x", "y", "z", *NAMES)}
    centres = np.stack([values[axis] for axis in "xyz"], axis=1)
    opacity = scipy.special.expit(values["opacity"])
    kept = np.flatnonzero((opacity >= LEAST_OPACITY) & _all_finite(values))
    if len(kept):
        low, high = np.quantile(centres[kept], [OUTERMOST, 1 - OUTERMOST], axis=0)
        slack = STRAY * (high - low).max()
        near = (centres[kept] >= low - slack) & (centres[kept] <= high + slack)
        kept = kept[near.all(axis=1)]
    if not len(kept) or not np.ptp(centres[kept], axis=0).max() > 0:
        raise MeshError(
            "None of the splats is opaque.", "Export them with positions and opacities."
        )
    centres = centres[kept]
    cell = float(np.ptp(centres, axis=0).max() / CELLS)
    origin = centres.min(axis=0) - (MARGIN + 0.5) * cell
    shape = np.ceil((centres.max(axis=0) - origin) / cell).astype(int) + MARGIN + 1
    axes = _axes({name: column[kept] for name, column in values.items()})
    solid = _filled(_reached(centres, axes, origin, cell, shape))
    level = scipy.ndimage.gaussian_filter(solid.astype(np.float32), SMOOTHING)
    corners, faces = _surface(level, origin, cell)
    return corners, faces, _colors(vertices, kept, centres, corners, faces)


def _all_finite(values: Mapping[str, Floats]) -> Mask:
    finite: Mask = np.logical_and.reduce([np.isfinite(column) for column in values.values()])
    return finite


def _axes(values: Mapping[str, Floats]) -> Floats:
    """The three semi-axes of each splat, one standard deviation long, shape [n, 3, 3]."""
    quaternions = np.stack([values[f"rot_{i}"] for i in range(4)], axis=1)
    norm = np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions = np.where(norm > 0, quaternions, (1, 0, 0, 0))
    turns = scipy.spatial.transform.Rotation.from_quat(quaternions, scalar_first=True)
    logarithms = np.stack([values[f"scale_{i}"] for i in range(3)], axis=1)
    sigmas = np.exp(np.clip(logarithms, -50, 50))
    axes: Floats = np.swapaxes(turns.as_matrix(), 1, 2) * sigmas[:, :, None]
    return axes


def _reached(
    centres: Floats, axes: Floats, origin: Floats, cell: float, shape: npt.NDArray[np.int_]
) -> Mask:
    """Cells that hold the centre of a splat, or what is one standard deviation from it."""
    reached = np.zeros(shape, bool)
    longest = MARGIN * cell / 2  # what reaches farther is no part of a surface
    lengths = np.linalg.norm(axes, axis=2, keepdims=True)
    ends = axes * np.minimum(1, longest / np.maximum(lengths, 1e-300))
    for direction in (np.zeros(3), *DIRECTIONS):
        along = direction / max(float(np.linalg.norm(direction)), 1)
        places = centres + np.einsum("a,nax->nx", along, ends)
        reached[tuple(((places - origin) / cell).astype(int).T)] = True
    return reached


def _filled(reached: Mask) -> Mask:
    """The solid whose inside or shell is reached."""
    for gap in GAPS:
        thick = scipy.ndimage.binary_dilation(reached, iterations=gap)
        tight = scipy.ndimage.binary_fill_holes(thick)
        solid = scipy.ndimage.binary_erosion(tight, iterations=gap)
        inside = scipy.ndimage.binary_erosion(solid, iterations=3)
        if np.count_nonzero(inside) * 20 > np.count_nonzero(solid):
            without_specks: Mask = scipy.ndimage.binary_opening(solid)
            return without_specks
    raise MeshError(
        "The splats enclose no solid: they are open, or too far apart.",
        "Crop them to one closed object, or turn them into a mesh first.",
    )


def _surface(
    level: npt.NDArray[np.float32], origin: Floats, cell: float
) -> tuple[Floats, npt.NDArray[np.int32]]:
    """Where the level falls to `ISO_LEVEL`."""
    nx, ny, nz = level.shape
    k, j, i = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    places = np.stack([i, j, k], axis=-1).reshape(-1, 3).astype(np.float64)
    corners, faces, *_ = igl.marching_cubes(
        ISO_LEVEL - level.transpose(2, 1, 0).reshape(-1).astype(np.float64), places, nx, ny, nz
    )
    return origin + (corners + 0.5) * cell, np.asarray(faces, np.int32)


def _colors(
    vertices: Mapping[str, npt.NDArray[np.floating]],
    kept: npt.NDArray[np.intp],
    centres: Floats,
    corners: Floats,
    faces: npt.NDArray[np.int32],
) -> MeshColors | None:
    """Of each corner that of the nearest splat."""
    try:
        harmonics = np.stack([np.asarray(vertices[f"f_dc_{i}"])[kept] for i in range(3)], axis=1)
    except (KeyError, ValueError):
        return None
    shares = np.nan_to_num(0.5 + HARMONIC * harmonics.astype(np.float64))
    _, nearest = scipy.spatial.cKDTree(centres).query(corners)
    levels = np.rint(255 * np.clip(shares[nearest], 0, 1)).astype(np.uint8)
    return MeshColors.of_corners(levels[faces])
