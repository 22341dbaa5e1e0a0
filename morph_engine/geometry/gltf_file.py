"""glTF files made plain: triangles at rest and base colours, such that trimesh reads them right.

trimesh takes normalized integers for whole numbers, reads the first set of texture coordinates
whatever a material asks for, skips fans, places skinned meshes by their nodes and loses what hangs
on a camera (glTF 2.0, sections 3.6.2, 3.7 and 3.9; KHR_mesh_quantization, KHR_texture_transform).
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from morph_engine.errors import MeshError
from morph_engine.geometry import rotation

Json = dict[str, Any]
Array = npt.NDArray[Any]

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
TRIANGLES, STRIP, FAN = 4, 5, 6

TEXTURED = "textured"
"""Name of a material that should have a texture, for where trimesh finds none."""

_PLACED_BY = ("matrix", "translation", "rotation", "scale")


def gltf_header(data: bytes, kind: str) -> Json:
    """The document of a file of kind ``glb`` or ``gltf``."""
    if kind == "gltf":
        return dict(json.loads(data))
    return dict(json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")]))


def plain_gltf(data: bytes, kind: str) -> bytes:
    """The same scene as a GLB file of plain triangles.

    Args:
        data: The file, whose buffers are in it.
        kind: ``glb`` or ``gltf``.

    Raises:
        MeshError: It is compressed.
    """
    header = gltf_header(data, kind)
    return _Plain(header, _buffers(header, data, kind)).file()


def _buffers(header: Json, data: bytes, kind: str) -> list[bytes]:
    binary = b""
    if kind == "glb":
        start = 20 + int.from_bytes(data[12:16], "little")
        length = int.from_bytes(data[start : start + 4], "little")
        binary = data[start + 8 : start + 8 + length]
    return [
        base64.b64decode(buffer["uri"].partition(",")[2]) if "uri" in buffer else binary
        for buffer in header.get("buffers", [])
    ]


class _Plain:
    """A file that is written anew from another one.

    Args:
        header: Its document.
        buffers: Its binary data.
    """

    def __init__(self, header: Json, buffers: Sequence[bytes]) -> None:
        self._source = header
        self._buffers = buffers
        self._chunks: list[bytes] = []
        self._length = 0
        self._views: list[Json] = []
        self._accessors: list[Json] = []
        self._known: dict[str, int] = {}
        self._meshes: list[Json] = []

    def file(self) -> bytes:
        """The file."""
        source = self._source
        self._meshes = [self._mesh(mesh) for mesh in source.get("meshes", [])]
        nodes, skinned = self._nodes()
        plain: Json = {"asset": {"version": "2.0"}, "nodes": nodes, "meshes": self._meshes}
        plain |= {name: source[name] for name in ("scene", "scenes", "textures") if name in source}
        if plain.get("scenes"):
            shown = plain["scenes"][plain.get("scene", 0)]
            plain |= {"scene": 0, "scenes": [{"nodes": [*shown.get("nodes", []), *skinned]}]}
        if source.get("materials"):
            plain["materials"] = [_base_color(material) for material in source["materials"]]
            plain["images"] = [self._image(image) for image in source.get("images", [])]
        plain |= {"accessors": self._accessors, "bufferViews": self._views}
        plain["buffers"] = [{"byteLength": self._length}]
        text = json.dumps({name: part for name, part in plain.items() if part}).encode()
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._chunks)
        size = 28 + len(text) + len(binary)
        head = struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON")
        return head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary

    def _mesh(self, mesh: Json, joints: Array | None = None) -> Json:
        """A mesh of triangles; where it has a skin, as the joints hold it, shape [j, 4, 4]."""
        parts = [
            self._primitive(primitive, joints)
            for primitive in mesh["primitives"]
            if primitive.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN)
        ]
        return {"primitives": parts}

    def _primitive(self, primitive: Json, joints: Array | None) -> Json:
        given = primitive["attributes"]
        plain: Json = {"attributes": {}, "mode": primitive.get("mode", TRIANGLES)}
        position = given["POSITION"]
        if joints is None:
            plain["attributes"]["POSITION"] = self._once(
                f"position {position}", lambda: self._numbers(position)
            )
        else:
            plain["attributes"]["POSITION"] = self._add(self._skinned(given, joints))
        if "COLOR_0" in given:
            color = given["COLOR_0"]
            plain["attributes"]["COLOR_0"] = self._once(
                f"color {color}", lambda: self._read(color), normalized=True
            )
        if "material" in primitive:
            plain["material"] = primitive["material"]
            texture = _texture_of(self._source["materials"][primitive["material"]])
            transform = texture.get("extensions", {}).get("KHR_texture_transform", {})
            places = f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"
            if places in given:
                plain["attributes"]["TEXCOORD_0"] = self._once(
                    f"places {given[places]} {json.dumps(transform)}",
                    lambda: _transformed(self._numbers(given[places]), transform),
                )
        if plain["mode"] == FAN:
            plain |= {"mode": TRIANGLES, "indices": self._add(self._fan(primitive))}
        elif "indices" in primitive:
            indices = primitive["indices"]
            plain["indices"] = self._once(f"indices {indices}", lambda: self._read(indices))
        return plain

    def _fan(self, primitive: Json) -> Array:
        """Vertex indices of a fan's triangles, one after the other."""
        if "indices" in primitive:
            corners = self._read(primitive["indices"]).reshape(-1)
        else:
            corners = np.arange(len(self._read(primitive["attributes"]["POSITION"])))
        hub = np.broadcast_to(corners[:1], len(corners[2:]))
        return np.stack([hub, corners[1:-1], corners[2:]], axis=1).reshape(-1).astype("<u4")

    def _nodes(self) -> tuple[list[Json], list[int]]:
        """The nodes, and which of them are new ones for the meshes with skins in the scene."""
        nodes: list[Json] = []
        skinned: list[Json] = []
        shown = self._shown()
        for index, node in enumerate(self._source.get("nodes", [])):
            plain = {k: node[k] for k in (*_PLACED_BY, "name", "mesh", "children") if k in node}
            if "mesh" in plain and not self._meshes[plain["mesh"]]["primitives"]:
                del plain["mesh"]
            if "mesh" in plain and "skin" in node and index in shown:
                mesh = self._source["meshes"][plain.pop("mesh")]
                self._meshes.append(self._mesh(mesh, self._joints(node["skin"])))
                skinned.append({"mesh": len(self._meshes) - 1})
            nodes.append(plain)
        return nodes + skinned, list(range(len(nodes), len(nodes) + len(skinned)))

    def _shown(self) -> set[int]:
        """Indices of the nodes in the scene."""
        shown: set[int] = set()
        if not self._source.get("scenes"):
            return shown
        new = list(self._source["scenes"][self._source.get("scene", 0)].get("nodes", []))
        while new:
            node = new.pop()
            if node not in shown:
                shown.add(node)
                new += self._source["nodes"][node].get("children", [])
        return shown

    def _joints(self, skin: int) -> Array:
        """What each joint of a skin does to the mesh at rest, shape [j, 4, 4]."""
        described = self._source["skins"][skin]
        places = np.stack([self._place(joint) for joint in described["joints"]])
        if "inverseBindMatrices" not in described:
            return places
        columns = self._numbers(described["inverseBindMatrices"])
        joints: Array = places @ columns.reshape(-1, 4, 4).swapaxes(1, 2)
        return joints

    def _place(self, index: int) -> Array:
        """Where a node is in the scene, shape [4, 4]."""
        place, seen = np.eye(4), set[int]()
        at: int | None = index
        while at is not None and at not in seen:
            seen.add(at)
            place = _local_place(self._source["nodes"][at]) @ place
            at = self._parents.get(at)
        return place

    @cached_property
    def _parents(self) -> dict[int, int]:
        """The parent of each node that has one."""
        return {
            child: parent
            for parent, node in enumerate(self._source["nodes"])
            for child in node.get("children", [])
        }

    def _skinned(self, attributes: Json, joints: Array) -> Array:
        """Positions of a mesh's vertices as the joints hold them, shape [n, 3]."""
        points = self._numbers(attributes["POSITION"])
        points = np.concatenate([points, np.ones((len(points), 1))], axis=1)
        moved, total = np.zeros((len(points), 3)), np.zeros(len(points))
        for n in range(len([name for name in attributes if name.startswith("JOINTS_")])):
            bones, weights = (
                self._read(attributes[f"JOINTS_{n}"]),
                self._numbers(attributes[f"WEIGHTS_{n}"]),
            )
            for bone, weight in zip(bones.T, weights.T, strict=True):
                held = np.einsum("nij,nj->ni", joints[bone][:, :3], points)
                moved += weight[:, None] * held
                total += weight
        held = moved / np.where(total > 0, total, 1)[:, None]
        return np.where(total[:, None] > 0, held, points[:, :3]).astype("<f4")

    def _image(self, image: Json) -> Json:
        """A picture that is in the file; of others nothing."""
        if "bufferView" in image:
            view = self._view(self._bytes(image["bufferView"]))
            return {"bufferView": view} | {k: image[k] for k in ("mimeType",) if k in image}
        return image if image.get("uri", "").startswith("data:") else {}

    def _read(self, index: int) -> Array:
        """Values of an accessor as they are stored, shape [n, k]."""
        accessor = self._source["accessors"][index]
        width, count = WIDTHS[accessor["type"]], accessor["count"]
        dtype = np.dtype(COMPONENTS[accessor["componentType"]])
        if "bufferView" not in accessor:
            raise MeshError(
                "The glTF file is compressed or sparse.", "Export it as GLB without compression."
            )
        stride = self._source["bufferViews"][accessor["bufferView"]].get("byteStride")
        data = self._bytes(accessor["bufferView"])[accessor.get("byteOffset", 0) :]
        values = _strided(data, dtype, count, width, stride)
        if sparse := accessor.get("sparse"):
            values = values.copy()
            at, changed = sparse["indices"], sparse["values"]
            of = _strided(
                self._bytes(at["bufferView"])[at.get("byteOffset", 0) :],
                np.dtype(COMPONENTS[at["componentType"]]), sparse["count"], 1, None,
            )  # fmt: skip
            new = self._bytes(changed["bufferView"])[changed.get("byteOffset", 0) :]
            values[of[:, 0]] = _strided(new, dtype, sparse["count"], width, None)
        return values

    def _numbers(self, index: int) -> Array:
        """Values of an accessor, normalized integers as the shares that they stand for."""
        values = self._read(index)
        if not self._source["accessors"][index].get("normalized") or values.dtype.kind == "f":
            return values.astype("<f4")
        return np.maximum(values / np.iinfo(values.dtype).max, -1).astype("<f4")

    def _bytes(self, view: int) -> bytes:
        described = self._source["bufferViews"][view]
        if "EXT_meshopt_compression" in described.get("extensions", {}):
            raise MeshError("The glTF file is compressed.", "Export it as GLB without compression.")
        start = described.get("byteOffset", 0)
        data: bytes = self._buffers[described["buffer"]][start : start + described["byteLength"]]
        if len(data) < described["byteLength"]:
            raise ValueError("the file is cut off")
        return data

    def _once(self, name: str, values: Any, *, normalized: bool = False) -> int:
        """Index of the accessor of some values, which are computed and stored once."""
        if name not in self._known:
            self._known[name] = self._add(values(), normalized=normalized)
        return self._known[name]

    def _add(self, values: Array, *, normalized: bool = False) -> int:
        table = np.ascontiguousarray(values.reshape(len(values), -1))
        kind = next(n for n, name in COMPONENTS.items() if np.dtype(name) == table.dtype)
        accessor = {
            "bufferView": self._view(table.tobytes()),
            "componentType": kind,
            "count": len(table),
            "type": TYPES[table.shape[1]],
        }
        if normalized and table.dtype.kind == "u":
            accessor["normalized"] = True
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def _view(self, data: bytes) -> int:
        self._views.append({"buffer": 0, "byteOffset": self._length, "byteLength": len(data)})
        padded = data + bytes(-len(data) % 4)
        self._chunks.append(padded)
        self._length += len(padded)
        return len(self._views) - 1


def _strided(
    data: bytes, dtype: np.dtype[Any], count: int, width: int, stride: int | None
) -> Array:
    """Rows of numbers, shape [count, width], that begin every so many bytes."""
    row = width * dtype.itemsize
    if not stride or stride == row or count < 2:
        return np.frombuffer(data, dtype, count * width).reshape(count, width)
    if stride < row or (count - 1) * stride + row > len(data):
        raise ValueError("an accessor reaches beyond its data")
    every = np.frombuffer(data[: (count - 1) * stride + row].ljust(count * stride, b"\0"), np.uint8)
    return np.ascontiguousarray(every.reshape(count, stride)[:, :row]).view(dtype)


def _local_place(node: Json) -> Array:
    """A node's place in its parent, shape [4, 4]."""
    if "matrix" in node:
        return np.reshape(np.asarray(node["matrix"], np.float64), (4, 4)).T
    place = np.eye(4)
    turn = rotation.matrix(node.get("rotation", rotation.IDENTITY))
    place[:3, :3] = turn * node.get("scale", (1, 1, 1))
    place[:3, 3] = node.get("translation", (0, 0, 0))
    return place


def _texture_of(material: Json) -> Json:
    """The reference to a material's base colour texture; empty where it has none."""
    return dict(material.get("pbrMetallicRoughness", {}).get("baseColorTexture", {}))


def _base_color(material: Json) -> Json:
    """A material that has but its base colour."""
    base: Json = {}
    surface = material.get("pbrMetallicRoughness", {})
    if "baseColorFactor" in surface:
        base["baseColorFactor"] = surface["baseColorFactor"]
    if texture := _texture_of(material):
        base["baseColorTexture"] = {"index": texture["index"]}
    return {"name": TEXTURED if texture else "", "pbrMetallicRoughness": base}


def _transformed(places: Array, transform: Json) -> Array:
    """Texture coordinates scaled, then rotated, then shifted, as KHR_texture_transform asks."""
    angle = transform.get("rotation", 0.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    scaled = places * transform.get("scale", (1, 1))
    moved: Array = (scaled @ turn.T + transform.get("offset", (0, 0))).astype("<f4")
    return moved
