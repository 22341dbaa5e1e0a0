"""GLB with a motion: one mesh, a morph target per frame, and weights that go from one to the next.

Positions and normals of the targets are differences from the first frame, as 16-bit and 8-bit
integers (KHR_mesh_quantization): 12 bytes per vertex and frame. Where the shapes have colours, so
do the targets, as 16-bit differences in linear light; programs that know no targets of colours show
those of the first frame. Where the topology changes there are two meshes, and the scale of their
nodes shows one at a time.

Colours may be a texture, too. glTF has none that changes, so the mesh wears that of its first
frame, and a second mesh around it that of its last frame, transparent at first. One more target
makes the second opaque, as much as its weight says: programs that know no targets of colours show
the first texture throughout.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from morph_engine import srgb
from morph_engine.errors import ConfigError
from morph_engine.export.gltf import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    WHITE,
    GltfFile,
    Json,
    unit_normals,
)
from morph_engine.geometry.texture_atlas import TextureAtlas
from morph_engine.results.playback import Playback
from morph_engine.results.selection import Selection
from morph_engine.results.tracked_surface import TrackedMesh, track_surface
from morph_engine.srgb import CLAY

Floats = npt.NDArray[np.float64]

FRAMES_PER_SECOND = 24.0

MOST_BYTES = 18_000_000
"""What the targets of a mesh may take, so that a file stays below 20 MB."""

BYTES_PER_VERTEX = 12
"""Of a target: three 16-bit and three 8-bit integers, padded to multiples of four bytes."""

COLOR_BYTES = 8
"""Of colours likewise: three 16-bit integers, padded."""

LARGEST_POSITION = 32767
LARGEST_COLOR = 65535
LARGEST_COLOR_CHANGE = 32767
LARGEST_NORMAL = 127
LARGEST_ALPHA_CHANGE = 127

AROUND = 1e-3
"""How far a mesh is from the one around it in every frame, over half the extent of its motion."""

LEAST_NORMAL = 0.1
"""Shortest normal that a target leads to. Only its direction counts."""


def write(selection: Selection, path: Path) -> None:
    """Write the motion of a tracked surface; arguments as for `Format.write`.

    Raises:
        ConfigError: A loop is asked for: a mesh that moves does not come back to its first place.
    """
    timing = selection.timing
    if timing and timing.repeat == "loop":
        raise ConfigError(
            "A tracked surface ends as a different mesh than it begins with, so it cannot loop.",
            "Play it as ping-pong, or make a video, which can loop.",
        )
    targets = max(1, len(set(selection.frames)) - 1)
    surface = track_surface(
        selection, vertex_limit=MOST_BYTES // (_bytes_per_vertex(selection) * targets)
    )
    played = Playback(selection.trajectory, timing) if timing else None
    fps = timing.fps if timing else selection.fps or FRAMES_PER_SECOND
    file = GltfFile()
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    file.json["scenes"][0]["extras"] = {
        "frames": [surface.meshes[0].frames[0], surface.meshes[-1].frames[-1]],
        "frames_per_second": fps,
        "topology_changes_at_frame": surface.changes_at,
    }
    animation: Json = {"name": "morph", "channels": [], "samplers": []}
    first, changes_at = surface.meshes[0].frames[0], surface.changes_at
    for mesh, name in zip(surface.meshes, ("surface", "surface after"), strict=False):
        if played:
            times = np.arange(len(played.moments)) / fps
            shares = _shares(mesh, played)
        else:
            times = (np.array(mesh.frames) - first) / fps
            shares = np.eye(len(times), dtype=np.float32)
        second = mesh is not surface.meshes[0]
        for node in _add_mesh(file, mesh, name):
            weights = (shares @ node.weights).reshape(-1)
            _animate(animation, file, node.index, "weights", times, weights, "LINEAR")
            if changes_at is None:
                continue
            if played:
                changes, late = times, [m.station - 1 >= changes_at for m in played.moments]
            else:
                changes, late = np.array([0, (changes_at - first) / fps]), [False, True]
            scales = np.outer([node.size * (is_late == second) for is_late in late], np.ones(3))
            if second:
                file.json["nodes"][node.index]["scale"] = [0.0] * 3  # where nothing is played
            _animate(animation, file, node.index, "scale", changes, scales, "STEP")
    file.append("animations", animation)
    path.write_bytes(file.to_bytes())


def _bytes_per_vertex(selection: Selection) -> int:
    """What a target takes for each vertex, of both meshes where there are textures."""
    if selection.trajectory.colors is None:
        return BYTES_PER_VERTEX
    return BYTES_PER_VERTEX + (BYTES_PER_VERTEX if selection.texture else COLOR_BYTES)


def _shares(mesh: TrackedMesh, played: Playback) -> npt.NDArray[np.float32]:
    """Share of each frame of a mesh at each moment, shape [moments, frames], float32."""
    shares = np.zeros((len(played.moments), len(mesh.frames)), np.float32)
    for row, moment in zip(shares, played.moments, strict=True):
        for frame, weight in played.frames(moment):
            row[np.clip(frame - mesh.frames[0], 0, len(mesh.frames) - 1)] += weight
    return shares


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a mesh is in its own coordinates, in which no frame is farther than 1 from the first.

    Attributes:
        centre: Of the first frame's bounds [units of the selection], shape [3].
        size: Half the extent of the motion [units of the selection].
    """

    centre: Floats
    size: float

    @classmethod
    def of(cls, vertices: Floats) -> _Place:
        """For a mesh by frame, shape [T, v, 3]."""
        first = vertices[0]
        centre = (first.min(axis=0) + first.max(axis=0)) / 2
        largest = max(np.abs(first - centre).max(), np.abs(vertices - first).max())
        # a scale that single precision holds exactly is the same in the node and its animation
        return cls(centre, float(np.nextafter(np.float32(largest), np.float32(np.inf))))


@dataclass(frozen=True, eq=False)
class _Node:
    """A mesh in the file.

    Attributes:
        index: Of its node.
        size: Scale of the node.
        weights: Of its targets in each frame, shape [T, targets], float32.
    """

    index: int
    size: float
    weights: npt.NDArray[np.float32]


def _add_mesh(file: GltfFile, mesh: TrackedMesh, name: str) -> list[_Node]:
    """Add a mesh that moves, and the one around it if it has textures."""
    place = _Place.of(mesh.vertices)
    names = [f"frame {frame}" for frame in mesh.frames[1:]]
    weights = np.eye(len(mesh.frames), dtype=np.float32)[:, 1:]
    textures = mesh.textures
    if textures is None:
        primitive = _primitive(file, mesh, place)
        primitive["material"] = file.material(name, CLAY if mesh.colors is None else WHITE)
        return [_add_node(file, name, primitive, names, place, weights)]
    primitive = _primitive(file, mesh, place, textures.first.atlas)
    primitive["material"] = file.material(name, WHITE, texture=file.picture(textures.first.picture))
    later = f"{name}, last colours"
    around = _primitive(file, mesh, place, textures.last.atlas, away=AROUND)
    around["material"] = file.material(
        later, WHITE, texture=file.picture(textures.last.picture), transparent=True
    )
    _add_opacity(file, around, len(textures.last.atlas.uv))
    both = np.column_stack([weights, textures.shares]).astype(np.float32)
    return [
        _add_node(file, name, primitive, names, place, weights),
        _add_node(file, later, around, [*names, "last colours"], place, both),
    ]


def _primitive(
    file: GltfFile,
    mesh: TrackedMesh,
    place: _Place,
    atlas: TextureAtlas | None = None,
    *,
    away: float = 0.0,
) -> Json:
    """A mesh and its targets, cut open for an atlas, and moved outward by a share of its size."""
    corners = slice(None) if atlas is None else atlas.vertex_of
    faces = mesh.faces if atlas is None else atlas.faces
    begin = unit_normals(mesh.normals[0, corners])
    shapes = [
        (vertices[corners] - place.centre) / place.size + away * unit_normals(normals[corners])
        for vertices, normals in zip(mesh.vertices, mesh.normals, strict=True)
    ]
    attributes = {
        "POSITION": file.array(shapes[0].astype(np.float32), bounds=True, target=ARRAY_BUFFER),
        "NORMAL": file.array(begin, target=ARRAY_BUFFER),
    }
    light = None if mesh.colors is None else srgb.from_bytes(mesh.colors[:, corners])
    if light is not None:
        levels = np.rint(light[0] * LARGEST_COLOR).astype(np.uint16)
        attributes["COLOR_0"] = file.array(levels, normalized=True, target=ARRAY_BUFFER)
    if atlas is not None:
        attributes["TEXCOORD_0"] = file.array(atlas.uv, target=ARRAY_BUFFER)
    targets = []
    for index in range(1, len(mesh.frames)):
        moved = np.rint(np.clip(shapes[index] - shapes[0], -1, 1) * LARGEST_POSITION)
        turned = np.rint(_turned(begin, mesh.normals[index, corners]) * LARGEST_NORMAL)
        targets.append({
            "POSITION": file.array(
                moved.astype(np.int16), normalized=True, bounds=True, target=ARRAY_BUFFER
            ),
            "NORMAL": file.array(turned.astype(np.int8), normalized=True, target=ARRAY_BUFFER),
        })  # fmt: skip
        if light is not None:
            change = np.rint((light[index] - light[0]) * LARGEST_COLOR_CHANGE).astype(np.int16)
            targets[-1]["COLOR_0"] = file.array(change, normalized=True, target=ARRAY_BUFFER)
    indices = file.array(faces.reshape(-1).astype(np.uint32), target=ELEMENT_ARRAY_BUFFER)
    return {"attributes": attributes, "indices": indices, "targets": targets}


def _add_opacity(file: GltfFile, primitive: Json, count: int) -> None:
    """Make a mesh of so many corners transparent, and add a target that makes it opaque."""
    clear = np.zeros((count, 4), np.uint8)
    clear[:, :3] = 255
    opaque = np.zeros((count, 4), np.int8)
    opaque[:, 3] = LARGEST_ALPHA_CHANGE
    shown = file.array(opaque, normalized=True, target=ARRAY_BUFFER)
    primitive["attributes"]["COLOR_0"] = file.array(clear, normalized=True, target=ARRAY_BUFFER)
    # every target of a primitive has the same attributes, and zeros take no place
    at_rest = {key: file.zeros(index) for key, index in primitive["targets"][0].items()}
    unchanged = file.zeros(shown)
    for target in primitive["targets"]:
        target["COLOR_0"] = unchanged
    primitive["targets"].append(at_rest | {"COLOR_0": shown})


def _add_node(
    file: GltfFile,
    name: str,
    primitive: Json,
    names: list[str],
    place: _Place,
    weights: npt.NDArray[np.float32],
) -> _Node:
    """Add a node with a mesh of one primitive, whose targets have names."""
    mesh = {
        "name": name,
        "primitives": [primitive],
        "weights": [0.0] * len(names),
        "extras": {"targetNames": names},
    }
    node = {
        "name": name,
        "mesh": file.append("meshes", mesh),
        "translation": place.centre.tolist(),
        "scale": [place.size] * 3,
    }
    return _Node(file.node(node), place.size, weights)


def _turned(normals: npt.NDArray[np.float32], wanted: Floats) -> Floats:
    """What to add to normals to get the wanted directions, from -1 to 1 along every axis.

    A difference of two unit vectors may be longer, so that the sum is shorter where it must be.
    """
    goal = np.asarray(unit_normals(wanted), np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (1 + np.sign(goal) * normals) / np.abs(goal)
    length = np.clip(np.nanmin(np.where(goal == 0, np.inf, room), axis=1), LEAST_NORMAL, 1)
    turned: Floats = np.clip(length[:, None] * goal - normals, -1, 1)
    return turned


def _animate(
    animation: Json,
    file: GltfFile,
    node: int,
    path: str,
    times: Floats,
    values: npt.NDArray[np.floating],
    interpolation: str,
) -> None:
    """Let a property of a node take values at times [s]."""
    animation["samplers"].append({
        "input": file.array(times.astype(np.float32), bounds=True),
        "output": file.array(values.astype(np.float32)),
        "interpolation": interpolation,
    })  # fmt: skip
    animation["channels"].append({
        "sampler": len(animation["samplers"]) - 1,
        "target": {"node": node, "path": path},
    })  # fmt: skip
