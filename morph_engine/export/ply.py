"""PLY: points or triangles with numbers and colours at each, in binary."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morph_engine.export.format import Format
from morph_engine.results.selection import Selection


def write(selection: Selection, path: Path) -> None:
    """Write one frame; arguments as for `Format.write`."""
    (snapshot,) = selection.snapshots()
    normals = () if snapshot.faces is None else ("nx", "ny", "nz")
    kinds = [(axis, "<f8") for axis in "xyz"]
    kinds += [(name, "<f4") for name in (*normals, *snapshot.fields)]
    channels = () if snapshot.colors is None else ("red", "green", "blue")
    kinds += [(name, "u1") for name in channels]
    vertices = np.zeros(len(snapshot.vertices), kinds)
    for axis, column in zip("xyz", snapshot.vertices.T, strict=True):
        vertices[axis] = column
    for name, column in zip(normals, snapshot.normals.T, strict=False):
        vertices[name] = column
    for name, values in snapshot.fields.items():
        vertices[name] = values
    if snapshot.colors is not None:
        for name, column in zip(channels, snapshot.colors.T, strict=True):
            vertices[name] = column
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame {snapshot.frame}, {selection.units} units",
        f"element vertex {len(vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        *(f"property float {name}" for name in (*normals, *snapshot.fields)),
        *(f"property uchar {name}" for name in channels),
    ]
    faces = np.zeros(
        0 if snapshot.faces is None else len(snapshot.faces), [("n", "u1"), ("v", "<i4", 3)]
    )
    if snapshot.faces is not None:
        faces["n"], faces["v"] = 3, snapshot.faces
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    with path.open("wb") as file:
        file.write("\n".join([*header, "end_header", ""]).encode())
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


FORMAT = Format(
    name="ply",
    suffix=".ply",
    kind="frame",
    carries=frozenset({"points", "surface", "fields"}),
    description="Points or a surface with field values and the shapes' colours; "
    "Blender, MeshLab, CloudCompare, ParaView",
    write=write,
)
