"""Gaussian splats: each particle, or corner of the surface, is a soft ellipsoid of one colour.

The file is a PLY with the properties of Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance
Field Rendering" (2023), which viewers and engines read: logarithms of the three standard
deviations, a quaternion (w, x, y, z), the logit of the opacity, and spherical harmonics of degree
0 for the colour.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from morph_engine.export.format import Format
from morph_engine.export.vertex_light import vertex_light
from morph_engine.geometry.splats import HARMONIC
from morph_engine.results.selection import Selection, Snapshot
from morph_engine.srgb import CLAY, encoded

OPACITY = 0.98
"""Of a splat at its centre."""

SIGMA_OVER_H = 0.5
"""Standard deviation of a particle's splat over the spacing: neighbours merge without a gap."""

SIGMA_OVER_EDGE = 0.6
"""Standard deviation along the surface over the mean length of its edges at a corner."""

FLATNESS = 0.1
"""Standard deviation along the normal over that along the surface."""

SMALLEST = 1e-12
"""Length of an edge that has none, whose logarithm is still a number."""

SHADE = 0.45
"""Part of the light that clay loses where it faces away from the sky; splats are not lit."""

PROPERTIES = (
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity",
    "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
)  # fmt: skip

Floats = npt.NDArray[np.float64]


def write(selection: Selection, path: Path) -> None:
    """Write one frame; arguments as for `Format.write`."""
    (snapshot,) = selection.snapshots()
    path.write_bytes(to_bytes(snapshot))


def to_bytes(snapshot: Snapshot) -> bytes:
    """The file of one frame."""
    count = len(snapshot.vertices)
    if snapshot.faces is None:
        normals = np.tile([0.0, 0.0, 1.0], (count, 1))
        sigmas = np.full((count, 3), SIGMA_OVER_H * snapshot.spacing)
    else:
        normals = snapshot.normals
        along = SIGMA_OVER_EDGE * _edge_lengths(snapshot.vertices, snapshot.faces)
        sigmas = along[:, None] * (1, 1, FLATNESS)
    light = vertex_light(snapshot)
    if light is None:
        light = np.array(CLAY) * (1 - SHADE * (1 - normals[:, 2:]) / 2)
    else:
        light = encoded(light)
    values = np.column_stack(
        [
            snapshot.vertices,
            normals,
            (light - 0.5) / HARMONIC,
            np.full(count, np.log(OPACITY / (1 - OPACITY))),
            np.log(sigmas),
            _from_z_to(normals),
        ]
    ).astype("<f4")
    known = values[np.isfinite(values).all(axis=1)]  # viewers have no place for the others
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame {snapshot.frame}",
        f"element vertex {len(known)}",
        *(f"property float {name}" for name in PROPERTIES),
        "end_header",
        "",
    ]
    splats: bytes = known.tobytes()
    return "\n".join(header).encode() + splats


def _edge_lengths(vertices: Floats, faces: npt.NDArray[np.int32]) -> Floats:
    """Mean length of the edges at each corner, shape [v]."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    length = np.linalg.norm(vertices[end] - vertices[start], axis=1)
    total = np.bincount(start, length, len(vertices))
    mean: Floats = total / np.maximum(np.bincount(start, minlength=len(vertices)), 1)
    return np.maximum(mean, SMALLEST)


def _from_z_to(normals: Floats) -> Floats:
    """Shortest turns of the z axis to unit vectors, as quaternions (w, x, y, z), shape [n, 4]."""
    x, y, z = normals.T
    quaternions = np.stack([1 + z, -y, x, np.zeros_like(z)], axis=1)
    quaternions[z < -1 + 1e-9] = (0, 1, 0, 0)  # any half turn that takes it to -z
    unit: Floats = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return unit


FORMAT = Format(
    name="splat",
    suffix=".ply",
    kind="frame",
    carries=frozenset({"points", "surface", "fields"}),
    description="Gaussian splats, coloured by the first field or as the shapes; "
    "SuperSplat, splat viewers of three.js, Unity and Unreal",
    write=write,
)
