"""GLB with a motion: one mesh, a morph target per frame, and weights that go from one to the next.

Positions and normals of the targets are differences from the first frame, as 16-bit and 8-bit
integers (KHR_mesh_quantization): 12 bytes per vertex and frame. Where the shapes have colours, so
do the targets, as 16-bit differences in linear light; programs that know no targets of colours show
those of the first frame. Where the topology changes there are two meshes, and the scale of their
nodes shows one at a time.
"""

from __future__ import annotations

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

COLOR_BYTES_PER_VERTEX = 8
"""Likewise, of colours: three 16-bit integers."""

LARGEST_POSITION = 32767
LARGEST_COLOR = 65535
LARGEST_COLOR_CHANGE = 32767
LARGEST_NORMAL = 127

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
            "A tracked surface ends as another mesh than it begins, so that no loop closes.",
            "Play it as ping-pong, or make a video, which may be a loop.",
        )
    targets = max(1, len(set(selection.frames)) - 1)
    colored = selection.trajectory.colors is not None
    per_vertex = BYTES_PER_VERTEX + (COLOR_BYTES_PER_VERTEX if colored else 0)
    surface = track_surface(selection, vertex_limit=MOST_BYTES // (per_vertex * targets))
    played = Playback(selection.trajectory, timing) if timing else None
    fps = timing.fps if timing else selection.fps or FRAMES_PER_SECOND
    file = GltfFile()
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    file.json["scenes"][0]["extras"] = {
        "frames": [surface.meshes[0].frames[0], surface.meshes[-1].frames[-1]],
        "frames_per_second": fps,
        "topology_changes_at_frame": surface.changes_at,
    }
    material = file.material("matter", WHITE if colored else CLAY)
    animation: Json = {"name": "morph", "channels": [], "samplers": []}
    first = surface.meshes[0].frames[0]
    for mesh, name in zip(surface.meshes, ("surface", "surface after"), strict=False):
        node, size = _add_mesh(file, mesh, name, material)
        if played:
            times = np.arange(len(played.moments)) / fps
            weights = _shares(mesh, played)
        else:
            times = (np.array(mesh.frames) - first) / fps
            weights = np.eye(len(times), dtype=np.float32)
        _animate(animation, file, node, "weights", times, weights[:, 1:].reshape(-1), "LINEAR")
        if surface.changes_at is not None:
            second = mesh is surface.meshes[1]
            if played:
                late = [moment.station - 1 >= surface.changes_at for moment in played.moments]
            else:
                times = np.array([0, (surface.changes_at - first) / fps])
                late = [False, True]
            scales = np.outer([size * (is_late == second) for is_late in late], np.ones(3))
            if second:
                file.json["nodes"][node]["scale"] = [0.0] * 3  # where nothing is played
            _animate(animation, file, node, "scale", times, scales, "STEP")
    file.append("animations", animation)
    path.write_bytes(file.to_bytes())


def _shares(mesh: TrackedMesh, played: Playback) -> npt.NDArray[np.float32]:
    """Share of each frame of a mesh at each moment, shape [moments, frames], float32."""
    shares = np.zeros((len(played.moments), len(mesh.frames)), np.float32)
    for row, moment in zip(shares, played.moments, strict=True):
        for frame, weight in played.frames(moment):
            row[np.clip(frame - mesh.frames[0], 0, len(mesh.frames) - 1)] += weight
    return shares


def _add_mesh(file: GltfFile, mesh: TrackedMesh, name: str, material: int) -> tuple[int, float]:
    """Add a mesh with its targets; its node, and the node's scale.

    Positions in the mesh are shares of the scale, from the centre, so that each difference between
    two frames is from -1 to 1 along every axis.
    """
    first, normals = mesh.vertices[0], unit_normals(mesh.normals[0])
    centre = (first.min(axis=0) + first.max(axis=0)) / 2
    largest = max(np.abs(first - centre).max(), np.abs(mesh.vertices - first).max())
    # a scale that single precision holds exactly is the same in the node and its animation
    size = float(np.nextafter(np.float32(largest), np.float32(np.inf)))
    local = ((first - centre) / size).astype(np.float32)
    attributes = {
        "POSITION": file.array(local, bounds=True, target=ARRAY_BUFFER),
        "NORMAL": file.array(normals, target=ARRAY_BUFFER),
    }
    light = None if mesh.colors is None else srgb.from_bytes(mesh.colors)
    if light is not None:
        levels = np.rint(light[0] * LARGEST_COLOR).astype(np.uint16)
        attributes["COLOR_0"] = file.array(levels, normalized=True, target=ARRAY_BUFFER)
    targets = []
    frames = zip(mesh.vertices[1:], mesh.normals[1:], strict=True)
    for index, (vertices, wanted) in enumerate(frames, 1):
        moved = np.rint((vertices - first) / size * LARGEST_POSITION).astype(np.int16)
        turned = np.rint(_turned(normals, wanted) * LARGEST_NORMAL).astype(np.int8)
        targets.append({
            "POSITION": file.array(moved, normalized=True, bounds=True, target=ARRAY_BUFFER),
            "NORMAL": file.array(turned, normalized=True, target=ARRAY_BUFFER),
        })  # fmt: skip
        if light is not None:
            change = np.rint((light[index] - light[0]) * LARGEST_COLOR_CHANGE).astype(np.int16)
            targets[-1]["COLOR_0"] = file.array(change, normalized=True, target=ARRAY_BUFFER)
    corners = mesh.faces.reshape(-1).astype(np.uint32)
    primitive = {
        "attributes": attributes,
        "indices": file.array(corners, target=ELEMENT_ARRAY_BUFFER),
        "material": material,
        "targets": targets,
    }
    names = [f"frame {frame}" for frame in mesh.frames[1:]]
    added = file.append(
        "meshes",
        {
            "name": name,
            "primitives": [primitive],
            "weights": [0.0] * len(targets),
            "extras": {"targetNames": names},
        },
    )
    place = {"translation": centre.tolist(), "scale": [size] * 3}
    return file.node({"name": name, "mesh": added} | place), size


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
