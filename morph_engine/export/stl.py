"""STL: the surface as loose triangles, for printing and CAD."""

from __future__ import annotations

from pathlib import Path

import trimesh

from morph_engine.export.format import Format
from morph_engine.results.selection import Selection


def write(selection: Selection, path: Path) -> None:
    """Write one frame; arguments as for `Format.write`."""
    (snapshot,) = selection.snapshots()
    shape = trimesh.Trimesh(snapshot.vertices, snapshot.faces, process=False)
    path.write_bytes(trimesh.exchange.stl.export_stl(shape))


FORMAT = Format(
    name="stl",
    suffix=".stl",
    media_type="model/stl",
    kind="frame",
    carries=frozenset({"surface"}),
    description="A surface as loose triangles; CAD and 3D printing",
    write=write,
)
