"""GLB: glTF in one file, as the web and game engines read it; a field becomes vertex colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from morph_engine.export.format import Format
from morph_engine.rendering import colormap
from morph_engine.results.fields import FIELDS
from morph_engine.results.selection import Selection, Snapshot


def write(selection: Selection, path: Path) -> None:
    """Write one frame; arguments as for `Format.write`."""
    (snapshot,) = selection.snapshots()
    rgba = _colors(snapshot)
    if snapshot.faces is None:
        shape: Any = trimesh.PointCloud(snapshot.vertices, colors=rgba)  # type: ignore[no-untyped-call]
    else:
        shape = trimesh.Trimesh(
            snapshot.vertices, snapshot.faces, vertex_colors=rgba, process=False
        )
    scene: Any = trimesh.Scene(shape)
    path.write_bytes(scene.export(file_type="glb"))


def _colors(snapshot: Snapshot) -> npt.NDArray[np.uint8] | None:
    """RGBA by the first field, shape [v, 4]."""
    for name, values in snapshot.fields.items():
        diverging = FIELDS[name].diverging
        low, high = colormap.limits(values, diverging=diverging)
        chosen = colormap.DIVERGING if diverging else colormap.SEQUENTIAL
        rgb = colormap.colors(values, low, high, palette=chosen)
        opaque = np.column_stack([rgb, np.ones(len(rgb))])
        rgba: npt.NDArray[np.uint8] = np.rint(255 * opaque).astype(np.uint8)
        return rgba
    return None


FORMAT = Format(
    name="glb",
    suffix=".glb",
    media_type="model/gltf-binary",
    kind="frame",
    carries=frozenset({"points", "surface", "fields"}),
    description="Points or a surface, coloured by the first field; browsers, Blender, game engines",
    write=write,
)
