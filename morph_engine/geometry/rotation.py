"""Rotations as unit quaternions (x, y, z, w).

Without SciPy, which the API process does not load: it takes a sixth of a second and 40 MB.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Quaternion = tuple[float, float, float, float]
Floats = npt.NDArray[np.float64]

IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)
"""No rotation."""


def about_axis(axis: int, degrees: float) -> Quaternion:
    """The turn about a coordinate axis, 0, 1 or 2 for x, y or z, right-handed [degrees]."""
    half = np.radians(degrees) / 2
    parts = [0.0, 0.0, 0.0, float(np.cos(half))]
    parts[axis] = float(np.sin(half))
    x, y, z, w = parts
    return (x, y, z, w)


def from_euler(degrees: tuple[float, float, float]) -> Quaternion:
    """The rotation R_x R_y R_z by three angles [degrees]: about z first, then y, then x.

    The axes stay where they are. This is the order `XYZ` of three.js, and of SciPy in capitals.
    """
    if degrees == (0.0, 0.0, 0.0):
        return IDENTITY
    about_x, about_y, about_z = (about_axis(axis, angle) for axis, angle in enumerate(degrees))
    return product(about_x, product(about_y, about_z))


def product(second: Quaternion, first: Quaternion) -> Quaternion:
    """The rotation that does the first and then the second."""
    if first == IDENTITY or second == IDENTITY:
        return second if first == IDENTITY else first
    a, b = np.array(second), np.array(first)
    x, y, z = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    w = a[3] * b[3] - a[:3] @ b[:3]
    length = float(np.sqrt(x * x + y * y + z * z + w * w))
    return (float(x) / length, float(y) / length, float(z) / length, float(w) / length)


def inverse(rotation: Quaternion) -> Quaternion:
    """The rotation that undoes one."""
    x, y, z, w = rotation
    return IDENTITY if rotation == IDENTITY else (-x, -y, -z, w)


def between(first: Quaternion, second: Quaternion, share: float) -> Quaternion:
    """The rotation at a share of the shortest path between two, at an even pace."""
    if first == second:
        return first
    a, b = np.array(first), np.array(second)
    if a @ b < 0:
        b = -b
    angle = float(np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b))) * 2
    if angle < 1e-9:
        mixed = (1 - share) * a + share * b
    else:
        mixed = (np.sin((1 - share) * angle) * a + np.sin(share * angle) * b) / np.sin(angle)
    x, y, z, w = (mixed / np.linalg.norm(mixed)).tolist()
    return (x, y, z, w)


def matrix(rotation: Quaternion) -> Floats:
    """The orthogonal matrix of a rotation that acts on columns, shape [3, 3]."""
    x, y, z, w = rotation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
