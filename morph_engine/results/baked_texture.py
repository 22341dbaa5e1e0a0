"""The textures of a mesh that moves: its colours in the first frame, and those in the last.

Between two shapes the colours of the matter are mixed from both ends by one share for all of it, so
that two pictures and a share for each frame say everything. Each picture gives every triangle the
room that it has in that frame: an ear that grows out of a small spot is as sharp as the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from morph_engine.errors import ConfigError
from morph_engine.geometry import texture_atlas
from morph_engine.geometry.texture_atlas import TextureAtlas, unwrapped
from morph_engine.rendering.rasterizer import Canvas
from morph_engine.results.selection import Selection

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

AT_ONCE = 500_000
"""Pixels whose colours are found together, for the sake of memory."""


@dataclass(frozen=True, eq=False)
class BakedTexture:
    """The colours of a mesh in one frame, as a picture.

    Attributes:
        atlas: Where in the picture each triangle lies.
        picture: sRGB, shape [size, size, 3], uint8.
    """

    atlas: TextureAtlas
    picture: Picture


@dataclass(frozen=True, eq=False)
class BakedTextures:
    """The colours of a mesh that moves.

    Attributes:
        first: In its first frame.
        last: In its last one.
        shares: Of the last in the mixture for each frame, 0 to 1, shape [T].
    """

    first: BakedTexture
    last: BakedTexture
    shares: Floats


def check_texture(selection: Selection) -> None:
    """Refuse a texture where there can be none.

    Raises:
        ConfigError: The shapes have no colours, or the frames belong to several legs.
        ExtraError: xatlas is not installed.
    """
    trajectory = selection.trajectory
    if trajectory.colors is None:
        raise ConfigError(
            "The shapes have no colours for a texture.",
            "Omit the texture, or use a mesh file that has colours.",
        )
    legs = {trajectory.leg_of(frame) for frame in selection.frames}
    if len(legs) > 1:
        raise ConfigError(
            f"A texture can cover only one leg, and these frames span {len(legs)} legs.",
            "Request frames of one leg, or omit the texture.",
        )
    texture_atlas.require()


def baked(
    selection: Selection,
    shapes: list[Floats],
    faces: npt.NDArray[np.int32],
    frames: tuple[int, ...],
    spacings: list[float],
    size: int,
) -> BakedTextures:
    """Cut a mesh open as it is in its first frame and as it is in its last, and bake its colours.

    Args:
        selection: Of what trajectory.
        shapes: Corners of the mesh by frame [dx], each of shape [v, 3].
        faces: Its triangles, shape [f, 3].
        frames: Index of each frame, ascending.
        spacings: Lattice spacing h of the particles in each [dx].
        size: Edge of the pictures [pixels].
    """
    first, last = (
        _texture(selection, shapes[k], faces, frames[k], spacings[k], size) for k in (0, -1)
    )
    mixed = np.array([selection.color_share(frame) for frame in frames])
    return BakedTextures(first, last, (mixed - mixed[0]) / max(mixed[-1] - mixed[0], 1e-9))


def _texture(
    selection: Selection,
    vertices: Floats,
    faces: npt.NDArray[np.int32],
    frame: int,
    spacing: float,
    size: int,
) -> BakedTexture:
    """Colours of a frame; pixels beside the charts have those of the nearest one in a chart.

    Corners are carried to both shapes, and what lies between them goes along.
    """
    atlas = unwrapped(vertices, faces, size)
    picture = np.zeros((size, size, 3), np.uint8)
    passage = selection.passage(frame)
    begin, end = (
        _spread(atlas, places, size) for places in passage.carried_to_ends(vertices, spacing)
    )
    covered = np.isfinite(begin[..., 0])
    pixels = np.argwhere(covered)
    for rows, columns in (part.T for part in np.array_split(pixels, 1 + len(pixels) // AT_ONCE)):
        places = (ends[rows, columns].astype(np.float64) for ends in (begin, end))
        picture[rows, columns] = passage.colors_between(*places)
    nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return BakedTexture(atlas, picture[tuple(nearest)])


def _spread(atlas: TextureAtlas, values: Floats, size: int) -> npt.NDArray[np.float32]:
    """What lies at each pixel of values at corners of the mesh, shape [v, 3]; NaN beside it."""
    flat = np.zeros((len(atlas.uv), 3), np.float32)
    flat[:, :2] = (atlas.uv - 0.5) * np.array([size, -size], np.float32)
    a, b, c = (flat[atlas.faces[:, k], :2] for k in range(3))
    (along, rise), (across, height) = (b - a).T, (c - a).T
    mirrored = along * height - rise * across < 0
    faces = np.where(mirrored[:, None], atlas.faces[:, ::-1], atlas.faces)
    upward = np.tile(np.array([0, 0, 1], np.float32), (len(flat), 1))
    canvas = Canvas(size, size)
    canvas.triangles(flat, upward, values[atlas.vertex_of].astype(np.float32), faces)
    spread = canvas.colors.copy()
    spread[~canvas.covered] = np.nan
    return spread
