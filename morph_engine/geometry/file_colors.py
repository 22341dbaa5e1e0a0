"""Colours in mesh files: of vertices, of faces, of materials and their textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from morph_engine import srgb
from morph_engine.geometry.gltf_file import TEXTURED
from morph_engine.geometry.mesh_colors import NO_TEXTURE, MeshColors

TEXTURE_EDGE = 1024
"""Pixels along the longer side of a texture; those of a shape's particles are farther apart."""

TEXTURE_PIXELS_LIMIT = 2**26
"""Most pixels of a file's textures as they are stored: 200 MB in memory."""

TEXTURE_KINDS = ("PNG", "JPEG", "WEBP", None)
"""Formats of pictures in files; those of objects in memory have none."""

PAINTED = (2, 2)
"""Pixels of the picture that trimesh paints where it finds none."""

_WHITE = np.full(3, 255, np.uint8)


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a mesh file as trimesh has read it.

    Attributes:
        visual: Its `visual`.
        faces: Vertex indices as the part is placed, which may turn them, shape [f, 3].
        vertex_count: Number of its vertices.
    """

    visual: Any
    faces: npt.NDArray[np.integer]
    vertex_count: int


def read_colors(parts: Sequence[Part], kind: str) -> tuple[MeshColors | None, tuple[str, ...]]:
    """Colours of the triangles of all parts, one part after the other.

    Args:
        parts: The parts.
        kind: Format of the file: glTF has linear light at its vertices, the others sRGB.

    Returns:
        The colours, or None where the file has none, and a sentence for each that is left out.
    """
    textures = _Textures()
    found = [_of_part(part, kind, textures) for part in parts]
    if not any(part is not None for part in found):
        return None, textures.sentences
    whole = [
        MeshColors.of_corners(np.tile(_WHITE, (len(part.faces), 3, 1)))
        if colors is None
        else colors
        for part, colors in zip(parts, found, strict=True)
    ]
    colors = MeshColors(
        np.concatenate([each.corners for each in whole]),
        np.concatenate([each.uv for each in whole]),
        np.concatenate([each.texture_of for each in whole]),
        tuple(textures.pictures),
    )
    return (None if colors.one_grey else colors), textures.sentences


def _of_part(part: Part, kind: str, textures: _Textures) -> MeshColors | None:
    visual, faces = part.visual, part.faces
    is_linear = kind in ("glb", "gltf")
    if visual.kind == "face":
        corners = np.repeat(_bytes(visual.face_colors, is_linear)[:, None], 3, axis=1)
        return MeshColors.of_corners(corners)
    if visual.kind == "vertex":
        return MeshColors.of_corners(_bytes(visual.vertex_colors, is_linear)[faces])
    if visual.kind != "texture":
        return None
    if not is_linear:
        return _of_simple_material(visual, faces, textures)
    material = visual.material
    light = np.ones(3)
    if material.baseColorFactor is not None:
        light = np.asarray(material.baseColorFactor, np.float64)[:3] / 255
    at_vertices = visual.vertex_attributes.get("color")
    if at_vertices is not None and len(at_vertices) == part.vertex_count:
        light = light * srgb.from_bytes(_bytes(at_vertices, is_linear))
        corners = srgb.to_bytes(light)[faces]
    else:
        corners = np.tile(srgb.to_bytes(light), (len(faces), 3, 1))
    colors = MeshColors.of_corners(corners)
    index = NO_TEXTURE
    if material.baseColorTexture is not None and visual.uv is not None:
        index = textures.add(material.baseColorTexture)
    elif material.name == TEXTURED:
        textures.leave_out(
            "is too large, or in another file,",
            "Export the mesh as one GLB with pictures of at most 8192 x 8192 pixels",
        )
    if index == NO_TEXTURE:
        return colors
    return _textured(corners, visual.uv, faces, index)


def _textured(
    corners: srgb.Bytes, uv: npt.ArrayLike, faces: npt.NDArray[np.integer], index: int
) -> MeshColors:
    """Corner colours times a texture, whose places trimesh counts from below."""
    flipped = np.asarray(uv, np.float64) * (1, -1) + (0, 1)
    places = np.nan_to_num(flipped).astype(np.float32)[faces]
    return MeshColors(corners, places, np.full(len(faces), index, np.int16))


def _of_simple_material(
    visual: Any, faces: npt.NDArray[np.integer], textures: _Textures
) -> MeshColors | None:
    """Colours by the MTL of an OBJ: `map_Kd`, or else `Kd`, both sRGB."""
    material = visual.material
    image = material.image
    is_painted = image is not None and not image.format and image.size == PAINTED
    if image is not None and not is_painted and visual.uv is not None:
        index = textures.add(image)
        if index != NO_TEXTURE:
            white = np.tile(_WHITE, (len(faces), 3, 1))
            return _textured(white, visual.uv, faces, index)
    if "kd" not in material.kwargs:
        return None
    return MeshColors.of_corners(np.tile(material.main_color[:3], (len(faces), 3, 1)))


def _bytes(values: npt.ArrayLike, is_linear: bool) -> srgb.Bytes:
    """sRGB bytes of colours as a file has them, shape [n, 3 or 4]."""
    array = np.asarray(values)[:, :3]
    if array.dtype == np.uint8 and not is_linear:
        return array
    most = np.iinfo(array.dtype).max if array.dtype.kind in "iu" else 1
    shares = np.clip(np.nan_to_num(array.astype(np.float64)) / most, 0, 1)
    return srgb.to_bytes(shares if is_linear else srgb.linear(shares))


class _Textures:
    """The pictures of a file, each once and no larger than is of use; which are left out."""

    def __init__(self) -> None:
        self.pictures: list[srgb.Bytes] = []
        self.sentences: tuple[str, ...] = ()
        self._known: dict[int, int] = {}
        self._images: list[Image.Image] = []  # so that no other has the same id
        self._room = TEXTURE_PIXELS_LIMIT

    def add(self, image: Image.Image) -> int:
        """Index of a picture, or `NO_TEXTURE` where it cannot be used."""
        if id(image) not in self._known:
            self._images.append(image)
            self._known[id(image)] = self._read(image)
        return self._known[id(image)]

    def _read(self, image: Image.Image) -> int:
        width, height = image.size
        self._room -= width * height
        if self._room < 0:
            self.leave_out(f"of {width} x {height} pixels is too large", "Scale it down")
            return NO_TEXTURE
        if image.format not in TEXTURE_KINDS:
            self.leave_out("is neither PNG nor JPEG", "Export the mesh with PNG textures")
            return NO_TEXTURE
        try:
            image.draft("RGB", (TEXTURE_EDGE, TEXTURE_EDGE))  # a JPEG is unfolded no larger
            if image.mode.startswith("I"):  # greys of 16 bits, which `convert` would cut off at 255
                image = Image.fromarray((np.asarray(image) / 257).round().astype(np.uint8))
            small = image.convert("RGB")
        except Exception:  # decoders raise anything on a damaged picture
            self.leave_out("is damaged", "Export the mesh again")
            return NO_TEXTURE
        small.thumbnail((TEXTURE_EDGE, TEXTURE_EDGE), Image.Resampling.BOX)
        self.pictures.append(np.array(small, np.uint8))
        return len(self.pictures) - 1

    def leave_out(self, why: str, remedy: str) -> None:
        """Say that a texture is left out, and why."""
        sentence = f"A texture {why} and has been ignored. {remedy} to use it."
        if sentence not in self.sentences:
            self.sentences += (sentence,)
