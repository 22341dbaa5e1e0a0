"""A glTF 2.0 file in one piece (GLB), put together from arrays.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import io
import json
import struct
from importlib import metadata
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from morph_engine.srgb import CLAY, linear

Json = dict[str, Any]

ARRAY_BUFFER = 34962
"""Bytes of a buffer view are values of vertices."""

ELEMENT_ARRAY_BUFFER = 34963
"""Bytes of a buffer view are indices of vertices."""

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125,
              "float32": 5126}  # fmt: skip
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}

LINEAR, LINEAR_MIPMAP_LINEAR = 9729, 9987
"""How a texture is enlarged, and reduced."""

WHITE = (1.0, 1.0, 1.0)
"""Under colours of vertices, which are multiplied by it."""

ROUGHNESS = 0.6


class GltfFile:
    """Arrays that are added one by one, and the JSON that names them.

    Attributes:
        json: The document; parts are appended to its lists.
    """

    def __init__(self) -> None:
        version = metadata.version("chamfer-morph")
        self.json: Json = {
            "asset": {"version": "2.0", "generator": f"chamfer-morph {version}"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
        }
        self._chunks: list[bytes] = []
        self._length = 0

    def append(self, part: str, value: Json) -> int:
        """Append to a list of the document; the index there."""
        values = self.json.setdefault(part, [])
        values.append(value)
        return len(values) - 1

    def array(
        self,
        values: npt.NDArray[Any],
        *,
        normalized: bool = False,
        bounds: bool = False,
        target: int | None = None,
    ) -> int:
        """Add an array of numbers; the index of its accessor.

        Args:
            values: Shape [n] or [n, k], of a type in `COMPONENTS`. Values of vertices are padded to
                multiples of four bytes each.
            normalized: Whether integers stand for shares of the largest one.
            bounds: Whether the least and largest values are told, which positions and times need.
            target: What the bytes are for, if they are of vertices.
        """
        table = values.reshape(len(values), -1)
        accessor: Json = {
            "componentType": COMPONENTS[table.dtype.name],
            "count": len(table),
            "type": SHAPES[table.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor["min"] = table.min(axis=0).tolist()
            accessor["max"] = table.max(axis=0).tolist()
        view: Json = {"buffer": 0}
        if target is not None:
            view["target"] = target
        if target == ARRAY_BUFFER:
            size = table.itemsize
            padded = np.zeros((len(table), -(-table.shape[1] * size // 4) * 4 // size), table.dtype)
            padded[:, : table.shape[1]] = table
            table = padded
            view["byteStride"] = table.shape[1] * size
        data = np.ascontiguousarray(table, table.dtype.newbyteorder("<")).tobytes()
        accessor["bufferView"] = self._bytes(data, view)
        return self.append("accessors", accessor)

    def zeros(self, like: int) -> int:
        """Add as many zeros as another accessor has values, which take no place; its index."""
        accessor = {k: v for k, v in self.json["accessors"][like].items() if k != "bufferView"}
        for bound in {"min", "max"} & accessor.keys():
            accessor[bound] = [0] * len(accessor[bound])
        return self.append("accessors", accessor)

    def picture(self, pixels: npt.NDArray[np.uint8]) -> int:
        """Add a picture, shape [height, width, 3], sRGB, as a PNG and a texture; its index."""
        png = io.BytesIO()
        Image.fromarray(pixels).save(png, "png")
        view = self._bytes(png.getvalue(), {"buffer": 0})
        image = self.append("images", {"bufferView": view, "mimeType": "image/png"})
        self.json["samplers"] = [{"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR}]
        return self.append("textures", {"source": image, "sampler": 0})

    def material(
        self,
        name: str,
        rgb: tuple[float, float, float] = CLAY,
        *,
        texture: int | None = None,
        transparent: bool = False,
    ) -> int:
        """Add a rough material; its index.

        Args:
            name: Its name.
            rgb: Its sRGB colour, 0 to 1; a texture is multiplied by it.
            texture: Index of a texture.
            transparent: Whether it covers as much as the alpha of its vertices says.
        """
        color = [*linear(np.array(rgb)).round(6).tolist(), 1.0]
        surface: Json = {
            "baseColorFactor": color,
            "metallicFactor": 0.0,
            "roughnessFactor": ROUGHNESS,
        }
        if texture is not None:
            surface["baseColorTexture"] = {"index": texture}
        added: Json = {"name": name, "pbrMetallicRoughness": surface}
        if transparent:
            added["alphaMode"] = "BLEND"
        return self.append("materials", added)

    def node(self, value: Json) -> int:
        """Add a node to the scene; its index."""
        index = self.append("nodes", value)
        self.json["scenes"][0]["nodes"].append(index)
        return index

    def _bytes(self, data: bytes, view: Json) -> int:
        view |= {"byteOffset": self._length, "byteLength": len(data)}
        self._chunks.append(data + bytes(-len(data) % 4))
        self._length += len(self._chunks[-1])
        return self.append("bufferViews", view)

    def to_bytes(self) -> bytes:
        """The file."""
        document = self.json | {"buffers": [{"byteLength": self._length}]}
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        data = b"".join(self._chunks)
        return b"".join([
            struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)),
            struct.pack("<I4s", len(text), b"JSON"), text,
            struct.pack("<I4s", len(data), b"BIN\0"), data,
        ])  # fmt: skip


def unit_normals(normals: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Normals of length 1, upward where there is none, shape [v, 3], float32."""
    known = np.linalg.norm(normals, axis=1, keepdims=True) > 0.5
    upward: npt.NDArray[np.float32] = np.where(known, normals, (0, 1, 0)).astype(np.float32)
    return upward
