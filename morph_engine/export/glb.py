"""GLB: glTF in one file, as the web and game engines read it.

A field becomes vertex colours; without one, these are the shapes' own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from morph_engine.export import animated_glb
from morph_engine.export.format import Format
from morph_engine.export.gltf import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    WHITE,
    GltfFile,
    unit_normals,
)
from morph_engine.export.vertex_light import vertex_light
from morph_engine.results.selection import Selection, Snapshot, known_points
from morph_engine.srgb import CLAY, Light

POINTS = 0
TRIANGLES = 4


def write(selection: Selection, path: Path) -> None:
    """Write one frame, or the motion of a tracked surface; arguments as for `Format.write`."""
    if selection.tracked:
        animated_glb.write(selection, path)
        return
    (snapshot,) = selection.snapshots()
    path.write_bytes(to_bytes(snapshot))


def to_bytes(snapshot: Snapshot) -> bytes:
    """The file of one frame.

    Raises:
        MeshError: All its particles are lost.
    """
    file = GltfFile()
    vertices = snapshot.vertices.astype(np.float32)
    known = known_points(vertices, snapshot.frame)  # glTF has no points that are nowhere
    attributes = {"POSITION": file.array(vertices[known], bounds=True, target=ARRAY_BUFFER)}
    primitive = {"attributes": attributes, "mode": POINTS}
    light = vertex_light(snapshot)
    if light is not None:
        colors = _opaque(light[known])
        attributes["COLOR_0"] = file.array(colors, normalized=True, target=ARRAY_BUFFER)
    if snapshot.faces is not None:
        normals = unit_normals(snapshot.normals)
        attributes["NORMAL"] = file.array(normals, target=ARRAY_BUFFER)
        corners = snapshot.faces.reshape(-1).astype(np.uint32)
        primitive["indices"] = file.array(corners, target=ELEMENT_ARRAY_BUFFER)
        primitive["mode"] = TRIANGLES
    primitive["material"] = file.material("matter", CLAY if light is None else WHITE)
    name = "particles" if snapshot.faces is None else "surface"
    mesh = file.append("meshes", {"name": name, "primitives": [primitive]})
    file.node({"name": name, "mesh": mesh, "extras": {"frame": snapshot.frame}})
    return file.to_bytes()


def _opaque(light: Light) -> npt.NDArray[np.uint16]:
    rgba = np.column_stack([light, np.ones(len(light))])
    levels: npt.NDArray[np.uint16] = np.rint(65535 * rgba).astype(np.uint16)
    return levels


FORMAT = Format(
    name="glb",
    suffix=".glb",
    media_type="model/gltf-binary",
    kind="frame",
    carries=frozenset({"points", "surface", "fields", "tracked", "texture"}),
    timed=True,
    description="Points, a surface or a moving mesh, coloured by the first field or as "
    "the shapes; browsers, Blender, game engines",
    write=write,
)
