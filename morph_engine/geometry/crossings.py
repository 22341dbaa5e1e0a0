"""By how much the winding number differs between the two ends of a short straight path.

A path from c to p crosses a triangle if p lies in the cone that c and the triangle span, and beyond
its plane. The winding number falls by one where the path goes along the triangle's normal, and
rises by one where it goes against it. For a c and a triangle the cone is bounded by four planes,
found once for all p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from morph_engine.row_blocks import row_blocks

Floats = npt.NDArray[np.float64]

TOUCH = 1e-7
"""From the border of a cone, below which it is left open whether a path crosses [cells]."""


@dataclass(frozen=True, eq=False)
class Cones:
    """What lies behind triangles, as seen from a point each.

    Attributes:
        normals: Of the four planes, towards the inside, unit length; shape [k, 4, 3].
        distance: Of the triangle's plane, the last of the four, from the point; shape [k].
        change: Of the winding number behind the triangle, -1 or 1, shape [k].
    """

    normals: Floats
    distance: Floats
    change: npt.NDArray[np.int8]

    @classmethod
    def behind(cls, triangles: Floats) -> Cones:
        """Behind triangles, shape [k, 3, 3], in coordinates about the points."""
        sides = np.cross(triangles, np.roll(triangles, -1, axis=1))
        normals = np.concatenate([sides, sides.sum(axis=1, keepdims=True)], axis=1)
        lengths = np.sqrt(np.einsum("kni,kni->kn", normals, normals))
        normals /= np.maximum(lengths, 1e-300)[:, :, None]
        distance = np.einsum("ki,ki->k", normals[:, 3], triangles[:, 0])
        normals[distance < 0] *= -1
        return cls(normals, np.abs(distance), np.where(distance < 0, 1, -1).astype(np.int8))


def count_crossings(
    ends: Floats,
    first: npt.NDArray[np.integer],
    last: npt.NDArray[np.integer],
    cones: Cones,
    clearance: float,
) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.bool_]]:
    """What triangles change the winding number by along paths to these ends, and where in doubt.

    Args:
        ends: In coordinates about where each path begins [cells], shape [n, 3].
        first: The first cone of each that may be entered, shape [n].
        last: One past the last of them, shape [n].
        cones: As seen from where the paths begin.
        clearance: From the plane of a triangle, below which no path begins [cells].
    """
    change, doubtful = np.zeros(len(ends), np.int8), np.zeros(len(ends), np.bool_)
    for block in row_blocks(len(ends)):
        counts = last[block] - first[block]
        path = np.repeat(np.arange(len(counts)), counts)
        cone = np.arange(len(path)) + np.repeat(first[block] - (np.cumsum(counts) - counts), counts)
        within = np.einsum("kni,ki->nk", cones.normals[cone], ends[block][path], order="C")
        within[3] -= cones.distance[cone]
        depth = within.min(axis=0)
        change[block] = np.bincount(path, cones.change[cone] * (depth > 0), len(counts))
        doubt = (np.abs(depth) < TOUCH) | (cones.distance[cone] < clearance)
        doubtful[block][path[doubt]] = True
    return change, doubtful
