"""glTF files as exporters write them: quantized, skinned, in fans, with textures moved about."""

from __future__ import annotations

import base64
import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from morph_engine import srgb
from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.mesh_colors import nearest_colors

BOX = trimesh.creation.box(extents=(1, 1, 1))
BOX.apply_translation((0.5, 0.5, 0.5))
CORNERS = BOX.vertices.astype("<f4")
INDICES = BOX.faces.reshape(-1).astype("<u2")
PLACES = CORNERS[:, :2]
"""Texture coordinates: the picture from the left and from the top is seen from along z."""

QUARTERS = np.array([(0.25, 0.25, 0), (0.75, 0.25, 0), (0.25, 0.75, 0), (0.75, 0.75, 0)])
COLORS = np.array([(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0)], np.uint8)
"""Those of the picture in its quarters."""

TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
CODES = {"<i2": 5122, "|u1": 5121, "<u2": 5123, "<f4": 5126}


class Writer:
    """Writes a glTF file array by array."""

    def __init__(self):
        self.document = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}], "accessors": [], "bufferViews": [],
        }  # fmt: skip
        self.binary = b""

    def view(self, content, **more):
        """Add bytes; the index of their view."""
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)}
        self.document["bufferViews"].append(view | more)
        self.binary += content
        return len(self.document["bufferViews"]) - 1

    def array(self, values, *, normalized=False, stride=None):
        """Add an array, each row padded to so many bytes; the index of its accessor."""
        rows = np.ascontiguousarray(values.reshape(len(values), -1))
        content = rows.view(np.uint8).reshape(len(rows), -1)
        if stride:
            content = np.pad(content, ((0, 0), (0, stride - content.shape[1])))
        accessor = {
            "bufferView": self.view(
                content.tobytes(), **({"byteStride": stride} if stride else {})
            ),
            "componentType": CODES[rows.dtype.str],
            "count": len(rows),
            "type": TYPES[rows.shape[1]],
        }
        self.document["accessors"].append(accessor | ({"normalized": True} if normalized else {}))
        return len(self.document["accessors"]) - 1

    def mesh(self, *primitives):
        """Let these be the only mesh."""
        self.document["meshes"] = [{"primitives": list(primitives)}]

    def material(self, **reference):
        """Let the picture of four colours be the base colour."""
        image = np.zeros((64, 64, 3), np.uint8)
        for k, color in enumerate(COLORS):
            image[32 * (k // 2) :, 32 * (k % 2) :] = color
        image[:32, 32:], image[32:, :32] = COLORS[1], COLORS[2]
        file = io.BytesIO()
        Image.fromarray(image).save(file, "PNG")
        view = self.view(file.getvalue())
        self.document |= {
            "images": [{"bufferView": view, "mimeType": "image/png"}],
            "textures": [{"source": 0}],
            "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0} | reference}}],
        }

    def save(self, path):
        """Write the file, and read it as a mesh."""
        self.binary += bytes(-len(self.binary) % 4)
        buffer = {"byteLength": len(self.binary)}
        if path.suffix == ".gltf":
            data = base64.b64encode(self.binary).decode()
            buffer["uri"] = f"data:application/octet-stream;base64,{data}"
        text = json.dumps(self.document | {"buffers": [buffer]}).encode()
        text += b" " * (-len(text) % 4)
        if path.suffix == ".gltf":
            path.write_bytes(text)
        else:
            size = 28 + len(text) + len(self.binary)
            head = struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON")
            path.write_bytes(
                head + text + struct.pack("<I4s", len(self.binary), b"BIN\0") + self.binary
            )
        return load_mesh(path)


@pytest.fixture
def file():
    """A file that is begun."""
    return Writer()


def seen(mesh):
    """sRGB colours of the four quarters."""
    return srgb.to_bytes(nearest_colors(QUARTERS, mesh.vertices, mesh.faces, mesh.colors))


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("kind", ["<f4", "<u2", "|u1"])
def test_texture_coordinates_of_any_type(tmp_path, file, kind, suffix):
    """Integers are shares of the largest one."""
    places = PLACES.astype(kind)
    if kind != "<f4":
        places = np.rint(PLACES * np.iinfo(kind).max).astype(kind)
    at = {"POSITION": file.array(CORNERS)}
    at["TEXCOORD_0"] = file.array(
        places, normalized=kind != "<f4", stride=4 if kind == "|u1" else None
    )
    file.material()
    file.mesh({"attributes": at, "indices": file.array(INDICES), "material": 0})
    np.testing.assert_array_equal(seen(file.save(tmp_path / f"box{suffix}")), COLORS)


@pytest.mark.parametrize("extended", [False, True])
def test_the_set_of_texture_coordinates_that_is_asked_for(tmp_path, file, extended):
    """By the reference to the texture, or by the extension, which overrules it."""
    at = {"POSITION": file.array(CORNERS)}
    at |= {"TEXCOORD_0": file.array(0 * PLACES), "TEXCOORD_1": file.array(PLACES)}
    transform = {"extensions": {"KHR_texture_transform": {"texCoord": 1}}}
    file.material(**(transform | {"texCoord": 0} if extended else {"texCoord": 1}))
    file.mesh({"attributes": at, "indices": file.array(INDICES), "material": 0})
    np.testing.assert_array_equal(seen(file.save(tmp_path / "box.glb")), COLORS)


def test_a_texture_that_is_scaled_turned_and_moved(tmp_path, file):
    """Undone beforehand, the transform leads to the same picture."""
    angle, scale, offset = np.pi / 2, (2, 4), (0.5, 0.25)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    before = ((PLACES - offset) @ turn) / scale
    at = {"POSITION": file.array(CORNERS), "TEXCOORD_0": file.array(before.astype("<f4"))}
    transform = {"rotation": angle, "scale": scale, "offset": offset}
    file.material(extensions={"KHR_texture_transform": transform})
    file.mesh({"attributes": at, "indices": file.array(INDICES), "material": 0})
    np.testing.assert_array_equal(seen(file.save(tmp_path / "box.glb")), COLORS)


def test_a_quarter_turn_is_counter_clockwise_seen_on_the_picture(tmp_path, file):
    """Coordinates go from the right edge to the top one, as three.js and others have it."""
    at = {"POSITION": file.array(CORNERS), "TEXCOORD_0": file.array(PLACES)}
    transform = {"rotation": np.pi / 2, "offset": (0, 1)}
    file.material(extensions={"KHR_texture_transform": transform})
    file.mesh({"attributes": at, "indices": file.array(INDICES), "material": 0})
    np.testing.assert_array_equal(seen(file.save(tmp_path / "box.glb")), COLORS[[2, 0, 3, 1]])


def test_quantized_positions(tmp_path, file):
    """Two boxes, each scaled and placed by its node."""
    levels = np.rint((2 * CORNERS - 1) * 32767).astype("<i2")
    at = {"POSITION": file.array(levels, normalized=True, stride=8)}
    file.mesh({"attributes": at, "indices": file.array(INDICES)})
    file.document["nodes"] = [
        {"mesh": 0, "scale": [0.5] * 3, "translation": [x, 0.5, 0.5]} for x in (0.5, 3.5)
    ]
    file.document["scenes"] = [{"nodes": [0, 1]}]
    mesh = file.save(tmp_path / "boxes.glb")
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [4, 1, 1]], atol=1e-4)
    assert mesh.volume == pytest.approx(2, rel=1e-3)


def test_fans_of_triangles(tmp_path, file):
    """An octahedron of two fans, one of them by the order of its vertices alone."""
    ring = [(1, 0, 0), (0, 0, 1), (-1, 0, 0), (0, 0, -1)]
    below = np.array([(0, -1, 0), *ring, ring[0]], "<f4")
    above = np.array([(0, 1, 0), *ring], "<f4")
    indices = file.array(np.array([0, 1, 4, 3, 2, 1], "<u2"))
    file.mesh(
        {"attributes": {"POSITION": file.array(above)}, "indices": indices, "mode": 6},
        {"attributes": {"POSITION": file.array(below)}, "mode": 6},
    )
    mesh = file.save(tmp_path / "octahedron.glb")
    assert (len(mesh.faces), mesh.volume) == (8, pytest.approx(4 / 3))


def test_a_skinned_mesh_is_where_its_joints_hold_it(tmp_path, file):
    """Its own node does not move it; half of the box hangs on a joint that has moved by 2."""
    joints = np.zeros((8, 4), "|u1")
    joints[:, 0] = CORNERS[:, 0] > 0.5
    weights = np.tile(np.array([1, 0, 0, 0], "<f4"), (8, 1))
    at = {"POSITION": file.array(CORNERS), "JOINTS_0": file.array(joints)}
    at["WEIGHTS_0"] = file.array(weights)
    inverse = np.tile(np.eye(4, dtype="<f4"), (2, 1, 1))
    inverse[1, 3, 0] = -1  # bound at x = 1; matrices are stored column by column
    file.mesh({"attributes": at, "indices": file.array(INDICES)})
    file.document["skins"] = [{"joints": [1, 2], "inverseBindMatrices": file.array(inverse)}]
    file.document["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [10, 0, 0]},
        {"children": [2], "translation": [0, 0, 5]},
        {"translation": [3, 0, 0]},
    ]
    file.document["scenes"] = [{"nodes": [0, 1]}]
    mesh = file.save(tmp_path / "box.glb")
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 5], [3, 1, 6]], atol=1e-6)


def test_what_hangs_on_a_camera_stays(tmp_path, file):
    """A camera is left out, its children are not."""
    at = {"POSITION": file.array(CORNERS)}
    file.mesh({"attributes": at, "indices": file.array(INDICES)})
    lens = {"yfov": 1, "znear": 0.1, "aspectRatio": 1.5}
    file.document["cameras"] = [{"type": "perspective", "perspective": lens}]
    file.document["nodes"] = [
        {"camera": 0, "translation": [10, 0, 0], "children": [1]},
        {"mesh": 0},
    ]
    np.testing.assert_allclose(file.save(tmp_path / "box.glb").bounds, [[10, 0, 0], [11, 1, 1]])


def sparse(file, where, what):
    """What an accessor says of values that differ."""
    return {
        "count": len(where),
        "indices": {"bufferView": file.view(where.tobytes()), "componentType": 5123},
        "values": {"bufferView": file.view(what.tobytes())},
    }


def test_sparse_values_replace_those_below(tmp_path, file):
    """A corner is pulled out; shape keys, which are mostly sparse, are left out."""
    at = {"POSITION": file.array(CORNERS)}
    far = np.flatnonzero((CORNERS == 1).all(axis=1)).astype("<u2")
    pulled = sparse(file, far, np.array([[3, 3, 3]], "<f4"))
    file.document["accessors"][0]["sparse"] = pulled
    key = {"componentType": 5126, "count": 8, "type": "VEC3", "sparse": pulled}
    file.document["accessors"].append(key)
    targets = [{"POSITION": len(file.document["accessors"]) - 1}]
    file.mesh({"attributes": at, "indices": file.array(INDICES), "targets": targets})
    np.testing.assert_allclose(file.save(tmp_path / "box.glb").bounds, [[0, 0, 0], [3, 3, 3]])


def test_compressed_files_are_refused_by_their_name(tmp_path, file):
    """Draco leaves accessors without data, meshopt views that are to be unpacked."""
    at = {"POSITION": file.array(CORNERS)}
    file.mesh({"attributes": at, "indices": file.array(INDICES)})
    view = file.document["bufferViews"][0]
    view["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}
    with pytest.raises(MeshError, match="compressed"):
        file.save(tmp_path / "meshopt.glb")
    del view["extensions"], file.document["accessors"][0]["bufferView"]
    with pytest.raises(MeshError, match="compressed"):
        file.save(tmp_path / "draco.glb")


def test_greys_of_sixteen_bits(tmp_path, file):
    """They are as bright as they say."""
    levels = np.repeat(np.array([[0, 65535 // 2]], np.uint16), 32, axis=1).repeat(64, axis=0)
    picture = io.BytesIO()
    Image.fromarray(levels).save(picture, "PNG")
    at = {"POSITION": file.array(CORNERS), "TEXCOORD_0": file.array(PLACES)}
    file.material()
    file.document["images"] = [
        {"bufferView": file.view(picture.getvalue()), "mimeType": "image/png"}
    ]
    file.mesh({"attributes": at, "indices": file.array(INDICES), "material": 0})
    colors = seen(file.save(tmp_path / "box.glb"))
    np.testing.assert_allclose(colors[0], 0, atol=1)
    np.testing.assert_allclose(colors[1], 127, atol=1)
