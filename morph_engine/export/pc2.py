"""PC2: a moving mesh as a point cache, in a zip archive beside the mesh that it moves.

A cache (Point Cache 2) holds the places of the vertices of a mesh in each frame, and nothing else:
a header of 32 bytes, then float32 coordinates, sample by sample, all little-endian. The mesh is an
OBJ whose vertices have the same order. Where the topology changes there are two of each.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from morph_engine.errors import ConfigError
from morph_engine.export import obj
from morph_engine.export.archive import EARLIEST
from morph_engine.export.format import Format
from morph_engine.results.selection import Selection, Snapshot
from morph_engine.results.tracked_surface import TrackedMesh, track_surface

HEADER = struct.Struct("<12siiffi")
"""Signature, version, vertices, frame of the first sample, frames from one to the next, samples."""

SIGNATURE = b"POINTCACHE2\0"
VERSION = 1


def write(selection: Selection, path: Path) -> None:
    """Write the motion of a tracked surface; arguments as for `Format.write`.

    Raises:
        ConfigError: The frames are not at even distances, or the topology changes between them.
    """
    _check_even(sorted(set(selection.frames)))
    surface = track_surface(selection)
    for mesh in surface.meshes:
        _check_even(mesh.frames)
    with zipfile.ZipFile(path, "w") as archive:
        for mesh, name in zip(surface.meshes, ("surface", "surface-after"), strict=False):
            for suffix, content in ((".obj", _first(mesh, selection)), (".pc2", _cache(mesh))):
                entry = zipfile.ZipInfo(name + suffix, EARLIEST)
                archive.writestr(entry, content, zipfile.ZIP_DEFLATED)


def _check_even(frames: Sequence[int]) -> None:
    if len(set(np.diff(frames))) > 1:
        shown = ", ".join(map(str, frames))
        raise ConfigError(
            f"A point cache needs evenly spaced frames, and frames {shown} are not.",
            "Request all frames, or a range such as 0-20.",
        )


def _first(mesh: TrackedMesh, selection: Selection) -> str:
    """The mesh in its first frame, as an OBJ."""
    colors = None if mesh.colors is None else mesh.colors[0]
    first = Snapshot(mesh.frames[0], mesh.vertices[0], mesh.faces, {}, 0.0, colors)
    return obj.to_text(first, selection.units)


def _cache(mesh: TrackedMesh) -> bytes:
    """The places of its vertices in all its frames."""
    samples, vertices, _ = mesh.vertices.shape
    step = mesh.frames[1] - mesh.frames[0] if samples > 1 else 1
    header = HEADER.pack(SIGNATURE, VERSION, vertices, mesh.frames[0], step, samples)
    return header + mesh.vertices.astype("<f4").tobytes()


FORMAT = Format(
    name="pc2",
    suffix=".zip",
    media_type="application/zip",
    kind="sequence",
    carries=frozenset({"tracked"}),
    description="A moving mesh as OBJ and point cache, zipped; Blender, Maya, 3ds Max, Houdini",
    write=write,
)
