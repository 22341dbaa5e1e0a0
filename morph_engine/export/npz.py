"""NPZ: all numbers of the frames as NumPy arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morph_engine.export.format import Format
from morph_engine.results.selection import Selection


def write(selection: Selection, path: Path) -> None:
    """Write the frames; arguments as for `Format.write`.

    ``positions`` [T, n, 3], ``frames`` [T], each field [T, n], ``source`` [n, 3], ``target``
    [m, 3], ``transform`` [T, 4, 4] from grid units to those of the positions; ``colors`` [T, n, 3],
    sRGB, uint8, where the shapes have any.
    """
    snapshots = list(selection.snapshots())
    fields = {
        name: np.stack([snapshot.fields[name] for snapshot in snapshots])
        for name in selection.fields
    }
    colors = [snapshot.colors for snapshot in snapshots if snapshot.colors is not None]
    arrays = fields | ({"colors": np.stack(colors)} if colors else {})
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            allow_pickle=False,
            positions=np.stack([snapshot.vertices for snapshot in snapshots]),
            frames=np.array(selection.frames),
            source=selection.placed_end("source"),
            target=selection.placed_end("target"),
            transform=np.stack([selection.transform(frame) for frame in selection.frames]),
            **arrays,
        )


FORMAT = Format(
    name="npz",
    suffix=".npz",
    kind="sequence",
    carries=frozenset({"points", "fields"}),
    description="All frames and fields as arrays; numpy.load",
    write=write,
)
