"""Which axis of a mesh points upwards, as far as its file tells."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from morph_engine.geometry.rotation import IDENTITY, Quaternion, about_axis

Up = Literal["y", "z"]

BY_FORMAT: dict[str, Up] = {"glb": "y", "gltf": "y", "stl": "z"}
"""glTF says that y points up. STL says nothing, but the CAD that writes it has z up."""

THICKNESS = 1e-3
"""A base is as flat as this share of the shape's height."""

LEAST_BASE = 0.2
"""Share of the bounding box's bottom that a base covers at least."""

LARGEST_OTHER = 0.02
"""Share that is flat at most, on the other axis' bottom."""


def guess_up(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int32], kind: str
) -> Up | None:
    """Which axis points upwards in a mesh; None where nothing tells.

    GLB, glTF and STL tell by themselves. Of other formats a mesh tells that stands on a flat base
    on one of both axes only. A slab, flat below and above alike, stands on neither.

    Args:
        vertices: Corner positions, shape [v, 3].
        faces: Vertex indices of triangles, counter-clockwise from outside, shape [f, 3].
        kind: Format of its file, as in its suffix.
    """
    if kind in BY_FORMAT:
        return BY_FORMAT[kind]
    on_y, on_z = (_flat_ends(vertices, faces, axis) for axis in (1, 2))
    if _is_base(on_y) and on_z[0] <= LARGEST_OTHER:
        return "y"
    if _is_base(on_z) and on_y[0] <= LARGEST_OTHER:
        return "z"
    return None


def turn_between(up: Up | None, upright: Up) -> Quaternion:
    """The turn about x that makes what points up along one axis point up along another."""
    if up is None or up == upright:
        return IDENTITY
    return about_axis(0, 90.0 if upright == "z" else -90.0)


def _is_base(flat_ends: tuple[float, float]) -> bool:
    below, above = flat_ends
    return below >= LEAST_BASE and above <= below / 2


def _flat_ends(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int32], axis: int
) -> tuple[float, float]:
    """Flat area at the lower and the upper end of an axis, over that of the bounding box there."""
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, axis] / 2
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    extent = upper - lower
    bottom = float(np.delete(extent, axis).prod())
    reach = THICKNESS * float(extent[axis])
    heights = corners[:, :, axis]
    below = -areas[(heights <= lower[axis] + reach).all(axis=1) & (areas < 0)].sum()
    above = areas[(heights >= upper[axis] - reach).all(axis=1) & (areas > 0)].sum()
    return float(below) / bottom, float(above) / bottom
