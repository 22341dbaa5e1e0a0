"""Colours of a mesh: at the corners of its triangles, and in textures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt

from morph_engine import srgb

igl: Any = lazy.load("igl")

Floats = npt.NDArray[np.float64]

NO_TEXTURE = -1


@dataclass(frozen=True, eq=False)
class MeshColors:
    """What a mesh looks like without light: as in glTF, corner colours times a texture.

    Attributes:
        corners: sRGB at the corners of each triangle, shape [f, 3, 3], uint8; white under a texture
            that is to be seen as it is.
        uv: Place of each corner in the texture, from its upper left corner to the lower right one,
            which repeats beyond, shape [f, 3, 2], float32.
        texture_of: Index of each triangle's texture, `NO_TEXTURE` for none, shape [f], int16.
        textures: Pictures in sRGB, each of shape [height, width, 3], uint8.
    """

    corners: srgb.Bytes
    uv: npt.NDArray[np.float32]
    texture_of: npt.NDArray[np.int16]
    textures: tuple[srgb.Bytes, ...] = ()

    @classmethod
    def of_corners(cls, corners: srgb.Bytes) -> MeshColors:
        """Colours without a texture, of shape [f, 3, 3]."""
        count = len(corners)
        nowhere = np.full(count, NO_TEXTURE, np.int16)
        return cls(np.ascontiguousarray(corners), np.zeros((count, 3, 2), np.float32), nowhere)

    @property
    def one_grey(self) -> bool:
        """Whether there is nothing but one grey, which says no more than no colour."""
        if (self.texture_of != NO_TEXTURE).any():
            return False
        first = self.corners.reshape(-1)[:1]
        return bool((self.corners == first).all())

    def of_faces(self, faces: npt.NDArray[np.intp]) -> MeshColors:
        """Those of some triangles."""
        return MeshColors(
            self.corners[faces], self.uv[faces], self.texture_of[faces], self.textures
        )

    def turned(self, faces: npt.NDArray[np.bool_]) -> MeshColors:
        """Those of the same triangles, some of which, shape [f], have their corners turned over."""
        both = (self.corners, self.uv)
        corners, uv = (np.where(faces[:, None, None], one[:, ::-1], one) for one in both)
        return MeshColors(corners, uv, self.texture_of, self.textures)

    def at(self, faces: npt.NDArray[np.integer], weights: Floats) -> srgb.Light:
        """Colours at points of triangles.

        Args:
            faces: Index of each point's triangle, shape [n].
            weights: Its barycentric coordinates, shape [n, 3].

        Returns:
            Linear light, shape [n, 3], float64.
        """
        light: srgb.Light = np.einsum("nk,nkc->nc", weights, srgb.from_bytes(self.corners[faces]))
        uv = np.einsum("nk,nkc->nc", weights, self.uv[faces])
        which = self.texture_of[faces]
        for index, texture in enumerate(self.textures):
            here = which == index
            light[here] *= _texels(texture, uv[here])
        return light

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """All of it by name, for a file; `restore` reads it."""
        found: dict[str, npt.NDArray[Any]] = {"corners": self.corners}
        if self.textures:
            found |= {"uv": self.uv, "texture_of": self.texture_of}
        return found | {f"texture_{k}": texture for k, texture in enumerate(self.textures)}

    @classmethod
    def restore(cls, arrays: dict[str, npt.NDArray[Any]]) -> MeshColors:
        """What `arrays` has told.

        Raises:
            KeyError: A part is missing.
        """
        if "uv" not in arrays:
            return cls.of_corners(arrays["corners"])
        textures = [arrays[f"texture_{k}"] for k in range(len(arrays) - 3)]
        return cls(arrays["corners"], arrays["uv"], arrays["texture_of"], tuple(textures))


def nearest_colors(
    points: npt.ArrayLike,
    vertices: Floats,
    faces: npt.NDArray[np.int32],
    colors: MeshColors,
) -> srgb.Light:
    """Colour of the nearest point of a mesh.

    Args:
        points: Positions [units of the mesh], shape [n, 3].
        vertices: Corners of the mesh, shape [v, 3].
        faces: Its triangles, shape [f, 3].
        colors: Its colours.

    Returns:
        Linear light, shape [n, 3], float64; that of clay where a position is not finite.
    """
    positions = np.asarray(points, np.float64)
    light = np.tile(srgb.linear(srgb.CLAY), (len(positions), 1))
    known = np.isfinite(positions).all(axis=1)
    if known.any():
        triangles = faces.astype(np.int64)
        _, face, nearest = igl.point_mesh_squared_distance(positions[known], vertices, triangles)
        light[known] = colors.at(
            face, _barycentric(nearest, *vertices[triangles[face]].swapaxes(0, 1))
        )
    return light


def _barycentric(points: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Barycentric coordinates of points of triangles, shape [n, 3]; thirds where one is a line."""
    with np.errstate(all="ignore"):
        weights = igl.barycentric_coordinates(points, a, b, c)
    weights = np.clip(np.where(np.isfinite(weights), weights, 1 / 3), 0, 1)
    inside: Floats = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    return inside


def _texels(texture: srgb.Bytes, uv: Floats) -> srgb.Light:
    """A picture at places in it, shape [n, 2], bilinear in linear light, shape [n, 3]."""
    height, width = texture.shape[:2]
    place = np.mod(np.nan_to_num(uv), 1.0) * (width, height) - 0.5
    corner = np.floor(place)
    share = place - corner
    light = np.zeros((len(uv), 3))
    for right in (0, 1):
        for down in (0, 1):
            x = (corner[:, 0].astype(np.int64) + right) % width
            y = (corner[:, 1].astype(np.int64) + down) % height
            weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - down - share[:, 1])
            light += weight[:, None] * srgb.from_bytes(texture[y, x])
    return light
