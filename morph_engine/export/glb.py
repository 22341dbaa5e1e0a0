"""GLB: glTF in one file, as the web and game engines read it; a field becomes vertex colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from morph_engine.export import animated_glb
from morph_engine.export.format import Format
from morph_engine.export.gltf import (
    ARRAY_BUFFER,
    CLAY,
    ELEMENT_ARRAY_BUFFER,
    GltfFile,
    linear,
    unit_normals,
)
from morph_engine.rendering import colormap
from morph_engine.results.fields import FIELDS
from morph_engine.results.selection import Selection, Snapshot

POINTS = 0
TRIANGLES = 4
WHITE = (1.0, 1.0, 1.0)
"""Under colours of vertices, which are multiplied by it."""


def write(selection: Selection, path: Path) -> None:
    """Write one frame, or the motion of a tracked surface; arguments as for `Format.write`."""
    if selection.tracked:
        animated_glb.write(selection, path)
        return
    (snapshot,) = selection.snapshots()
    file = GltfFile()
    vertices = snapshot.vertices.astype(np.float32)
    # glTF has no points that are nowhere
    known = np.isfinite(vertices).all(axis=1)
    attributes = {"POSITION": file.array(vertices[known], bounds=True, target=ARRAY_BUFFER)}
    primitive = {"attributes": attributes, "mode": POINTS}
    colors = _colors(snapshot)
    if colors is not None:
        attributes["COLOR_0"] = file.array(colors[known], normalized=True, target=ARRAY_BUFFER)
    if snapshot.faces is not None:
        normals = unit_normals(snapshot.normals)
        attributes["NORMAL"] = file.array(normals, target=ARRAY_BUFFER)
        corners = snapshot.faces.reshape(-1).astype(np.uint32)
        primitive["indices"] = file.array(corners, target=ELEMENT_ARRAY_BUFFER)
        primitive["mode"] = TRIANGLES
    primitive["material"] = file.material("matter", CLAY if colors is None else WHITE)
    name = "particles" if snapshot.faces is None else "surface"
    mesh = file.append("meshes", {"name": name, "primitives": [primitive]})
    file.node({"name": name, "mesh": mesh, "extras": {"frame": snapshot.frame}})
    path.write_bytes(file.to_bytes())


def _colors(snapshot: Snapshot) -> npt.NDArray[np.uint16] | None:
    """Linear RGBA by the first field, shape [v, 4]."""
    for name, values in snapshot.fields.items():
        diverging = FIELDS[name].diverging
        low, high = colormap.limits(values, diverging=diverging)
        chosen = colormap.DIVERGING if diverging else colormap.SEQUENTIAL
        rgb = linear(colormap.colors(values, low, high, palette=chosen))
        opaque = np.column_stack([rgb, np.ones(len(rgb))])
        rgba: npt.NDArray[np.uint16] = np.rint(65535 * opaque).astype(np.uint16)
        return rgba
    return None


FORMAT = Format(
    name="glb",
    suffix=".glb",
    media_type="model/gltf-binary",
    kind="frame",
    carries=frozenset({"points", "surface", "fields", "tracked"}),
    description="Points, a surface or a moving mesh, coloured by the first field; browsers, "
    "Blender, game engines",
    write=write,
)
