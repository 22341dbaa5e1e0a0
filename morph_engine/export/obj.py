"""OBJ: points or triangles as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morph_engine.export.format import Format
from morph_engine.results.selection import Selection


def write(selection: Selection, path: Path) -> None:
    """Write one frame; arguments as for `Format.write`."""
    (snapshot,) = selection.snapshots()
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"# frame {snapshot.frame}, {selection.units} units\n")
        np.savetxt(file, snapshot.vertices, fmt="v %.9g %.9g %.9g")
        if snapshot.faces is None:
            np.savetxt(file, np.arange(1, len(snapshot.vertices) + 1), fmt="p %d")
        else:
            np.savetxt(file, snapshot.faces + 1, fmt="f %d %d %d")


FORMAT = Format(
    name="obj",
    suffix=".obj",
    media_type="model/obj",
    kind="frame",
    carries=frozenset({"points", "surface"}),
    description="Points or a surface as text; every 3D program",
    write=write,
)
