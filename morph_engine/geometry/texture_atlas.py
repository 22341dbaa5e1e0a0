"""Texture atlases: a surface cut into charts that lie flat, side by side in one picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from morph_engine import optional_packages

Floats = npt.NDArray[np.float64]

PADDING = 4
"""Pixels between two charts, so that neither bleeds into the other where a picture is reduced."""


@dataclass(frozen=True, eq=False)
class TextureAtlas:
    """A mesh cut open for a picture.

    Attributes:
        vertex_of: Index of the mesh's vertex that each of the atlas stands for, shape [w]; where
            charts meet, several stand for one.
        faces: The triangles of the mesh, in their order, by vertices of the atlas, shape [f, 3],
            int32.
        uv: Place of each vertex in the picture, from its upper left corner to the lower right one,
            0 to 1, shape [w, 2], float32.
    """

    vertex_of: npt.NDArray[np.int64]
    faces: npt.NDArray[np.int32]
    uv: npt.NDArray[np.float32]


def require() -> None:
    """Refuse to go on where no atlas can be made.

    Raises:
        ExtraError: xatlas is not installed.
    """
    optional_packages.require("xatlas", extra="texture", purpose="A texture")


def unwrapped(vertices: Floats, faces: npt.NDArray[np.int32], size: int) -> TextureAtlas:
    """An atlas for a square picture of so many pixels an edge, by xatlas.

    Args:
        vertices: Corners of the mesh, shape [v, 3].
        faces: Its triangles, shape [f, 3].
        size: Edge of the picture [pixels].

    Raises:
        ExtraError: xatlas is not installed.
    """
    xatlas = optional_packages.load("xatlas", extra="texture", purpose="A texture")
    atlas, options = xatlas.Atlas(), xatlas.PackOptions()
    options.resolution, options.padding = size, PADDING
    atlas.add_mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    atlas.generate(pack_options=options)
    vertex_of, corners, uv = atlas[0]
    return TextureAtlas(vertex_of.astype(np.int64), corners.astype(np.int32), uv)
