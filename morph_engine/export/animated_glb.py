"""GLB with a motion: one mesh, a morph target per frame, and weights that go from one to the next.

Positions and normals of the targets are differences from the first frame, as 16-bit and 8-bit
integers (KHR_mesh_quantization): 12 bytes per vertex and frame. Where the shapes have colours, so
do the targets, as 16-bit differences in linear light; programs that know no targets of colours show
those of the first frame. Where the topology changes there are two meshes, and the scale of their
nodes shows one at a time.

Where a mesh goes far or grows much, 16 bits do not resolve both its way and its shape. Then a node
above it has an animated translation and scale, and the targets are differences in shape alone.

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
"""How far a mesh is from the one around it in every frame, over the size of its place."""

FARTHEST = 4.0
"""How far vertices may move, over the least extent of the mesh, where targets hold all of it: what
16 bits round off is less than a ten-thousandth of the mesh then."""

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
            times = np.linspace(0, played.seconds, len(played.moments))
            shares = _shares(mesh, played)
        else:
            times = (np.array(mesh.frames) - first) / fps
            shares = np.eye(len(times), dtype=np.float32)
        second = mesh is not surface.meshes[0]
        place = _Place.of(mesh.vertices)
        nodes = _add_mesh(file, mesh, place, name)
        if place.moves:
            _add_carrier(file, animation, name, nodes, place, times, shares)
            shares = place.shape_shares(shares)
        for node in nodes:
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
    """Where a mesh is in each frame; in its own coordinates no vertex moves farther than 1.

    Attributes:
        centres: Origin of those coordinates in each frame [units of the selection], shape [T, 3].
        sizes: Their unit in each frame [units of the selection], shape [T].
    """

    centres: Floats
    sizes: Floats

    @classmethod
    def of(cls, vertices: Floats) -> _Place:
        """For a mesh by frame, shape [T, v, 3]: the same in all frames unless it goes too far."""
        first = vertices[0]
        lows, highs = vertices.min(axis=1), vertices.max(axis=1)
        centres = (lows + highs) / 2
        largest = max(np.abs(first - centres[0]).max(), np.abs(vertices - first).max())
        if largest <= FARTHEST * (highs - lows).max(axis=1).min():
            count = len(vertices)
            return cls(np.tile(centres[0], (count, 1)), np.tile(_above(largest), count))
        centres = centres.astype(np.float32).astype(np.float64)  # as the animation has them
        halves = np.abs(vertices - centres[:, None]).max(axis=(1, 2))
        return cls(centres, _above(2 * (1 + 2 * AROUND) * halves))

    @property
    def moves(self) -> bool:
        """Whether it differs from frame to frame."""
        return bool(np.ptp(self.sizes) or np.ptp(self.centres, axis=0).any())

    def sizes_at(self, shares: npt.NDArray[np.float32]) -> Floats:
        """The unit at moments, by their shares of the frames, shape [moments]."""
        # a motion that goes past its end must not turn the mesh inside out
        sizes: Floats = np.maximum(shares @ self.sizes, self.sizes.min() / 2)
        return sizes

    def shape_shares(self, shares: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Shares of the frames in the shape at moments, by those in its vertices; as these."""
        of_shape: npt.NDArray[np.float32] = (
            shares * self.sizes / self.sizes_at(shares)[:, None]
        ).astype(np.float32)
        return of_shape


def _above(value: npt.ArrayLike) -> Floats:
    """The next larger numbers of single precision: the same in a node and in its animation."""
    return np.nextafter(np.asarray(value, np.float32), np.float32(np.inf)).astype(np.float64)


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


def _add_carrier(
    file: GltfFile,
    animation: Json,
    name: str,
    nodes: list[_Node],
    place: _Place,
    times: Floats,
    shares: npt.NDArray[np.float32],
) -> None:
    """Add a node that carries those of a mesh along, at times [s] with shares of the frames."""
    carrier = file.node({
        "name": f"{name}, place",
        "children": [node.index for node in nodes],
        "translation": place.centres[0].tolist(),
        "scale": [place.sizes[0]] * 3,
    })  # fmt: skip
    _animate(animation, file, carrier, "translation", times, shares @ place.centres, "LINEAR")
    scales = np.outer(place.sizes_at(shares), np.ones(3))
    _animate(animation, file, carrier, "scale", times, scales, "LINEAR")


def _add_mesh(file: GltfFile, mesh: TrackedMesh, place: _Place, name: str) -> list[_Node]:
    """Add a mesh that moves, and the one around it if it has textures."""
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
        (vertices[corners] - centre) / size + away * unit_normals(normals[corners])
        for vertices, normals, centre, size in zip(
            mesh.vertices, mesh.normals, place.centres, place.sizes, strict=True
        )
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
    """Add a node with a mesh of one primitive, whose targets have names.

    Where its place moves, the node is the child of one that is yet to be added.
    """
    mesh = {
        "name": name,
        "primitives": [primitive],
        "weights": [0.0] * len(names),
        "extras": {"targetNames": names},
    }
    node = {"name": name, "mesh": file.append("meshes", mesh)}
    if place.moves:
        return _Node(file.append("nodes", node), 1.0, weights)
    size = float(place.sizes[0])
    node |= {"translation": place.centres[0].tolist(), "scale": [size] * 3}
    return _Node(file.node(node), size, weights)


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
