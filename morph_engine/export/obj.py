"""OBJ: points or triangles as text."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import numpy as np

from morph_engine.export.format import Format
from morph_engine.results.run_record import Units
from morph_engine.results.selection import Selection, Snapshot

POINTS_PER_LINE = 1000
"""An element goes on in the next line after a backslash; some programs limit lines."""


def write(selection: Selection, path: Path) -> None:
    """Write one frame; arguments as for `Format.write`."""
    (snapshot,) = selection.snapshots()
    path.write_text(to_text(snapshot, selection.units), encoding="ascii", newline="\n")


def to_text(snapshot: Snapshot, units: Units) -> str:
    """The file of one frame."""
    file = StringIO()
    file.write(f"# frame {snapshot.frame}, {units} units\n")
    if snapshot.colors is None:
        np.savetxt(file, snapshot.vertices, fmt="v %.9g %.9g %.9g")
    else:
        table = np.hstack([snapshot.vertices, snapshot.colors / 255])
        np.savetxt(file, table, fmt="v %.9g %.9g %.9g %.4g %.4g %.4g")
    if snapshot.faces is None:
        file.write(_points(len(snapshot.vertices)))
    else:
        np.savetxt(file, snapshot.normals, fmt="vn %.6g %.6g %.6g")
        corners = np.repeat(snapshot.faces + 1, 2, axis=1)
        np.savetxt(file, corners, fmt="f %d//%d %d//%d %d//%d")
    return file.getvalue()


def _points(count: int) -> str:
    """All points as one element: programs warn of each element that they do not show."""
    names = [str(index) for index in range(1, count + 1)]
    lines = [
        " ".join(names[start : start + POINTS_PER_LINE])
        for start in range(0, count, POINTS_PER_LINE)
    ]
    return "p " + " \\\n".join(lines) + "\n"


FORMAT = Format(
    name="obj",
    suffix=".obj",
    media_type="model/obj",
    kind="frame",
    carries=frozenset({"points", "surface"}),
    description="Points or a surface as text; any 3D program",
    write=write,
)
