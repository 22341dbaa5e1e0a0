"""HTML: the frames and a viewer in one file, which a browser opens without a service or a network.

The file holds positions as 16-bit shares of the box around all of them, as differences from frame
to frame, deflated, in base64, and so are colours, as bytes. `server/web/src/standalone/film.js`
unpacks them. A loop has a frame more, in which what is in the last one is where the first one is:
the viewer goes there as videos do, see `results.playback.Playback`.
"""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from morph_engine.errors import MeshError, ResultError
from morph_engine.export.format import Format
from morph_engine.geometry.surface_reconstruction import Surface, are_near_the_middle
from morph_engine.geometry.surface_tracking import SurfaceTracker
from morph_engine.optimal_transport.plan import transport_plan
from morph_engine.results.playback import picture_table
from morph_engine.results.selection import Selection, known_points
from morph_engine.results.tracked_surface import (
    TrackedMesh,
    TrackedSurface,
    still_surface,
    track_surface,
)
from morph_engine.results.trajectory import Trajectory

Floats = npt.NDArray[np.float64]

VIEWER = Path(__file__).parent / "viewer"
"""Script and style sheet of the viewer, and the licences of the libraries in it, which
`npm run build` in server/web makes."""

LEVELS = 65535
"""Largest 16-bit share."""

MOST_BYTES = 10_000_000
"""Of arrays in a file, before they are deflated. What cannot be deflated is 13.4 MB in base64: with
0.7 MB for the viewer a file stays below 15 MB whatever it shows."""

NOTEBOOK_BYTES = 2_000_000
"""The same of what a notebook displays, which is stored in it."""

POSITION_BYTES, COLOR_BYTES, TRIANGLE_BYTES = 6, 3, 12

TRIANGLES_PER_VERTEX = 2
"""Of a closed surface."""

MESHES = 2
"""A surface has as many where its topology changes."""

QUICK = 200_000
"""Particles of all frames together whose surface is followed in some ten seconds."""

FRAME = """<iframe srcdoc="{page}" title="{title}" width="100%" height="520"
 style="border: 0" allowfullscreen></iframe>"""

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main id="view"></main>
<noscript>This page needs JavaScript.</noscript>
<script type="application/json" id="about">{about}</script>
<script type="text/plain" id="frames">{frames}</script>
<script>{script}</script>
<script type="text/plain" id="licenses">{licenses}</script>
</body>
</html>
"""


@dataclass(frozen=True, eq=False)
class LoopEnd:
    """Where a loop takes what is in its last frame: to the places and colours of the first one.

    Attributes:
        positions: Of the particles or vertices, in their order [any unit], shape [n, 3].
        colors: Their colours, sRGB, shape [n, 3], uint8; None without any.
    """

    positions: Floats
    colors: npt.NDArray[np.uint8] | None

    @classmethod
    def of_points(cls, points: Floats, colors: npt.NDArray[np.uint8] | None) -> LoopEnd:
        """Of particles by frame, shape [T, n, 3]: each goes to one of the first frame nearby."""
        partner = transport_plan(points[-1], points[0])
        return cls(points[0, partner], None if colors is None else colors[0, partner])

    @classmethod
    def of_surface(cls, surface: TrackedSurface, spacing: float) -> LoopEnd:
        """Of the mesh of the last frame, which is drawn to that of the first one."""
        first, last = surface.meshes[0], surface.meshes[-1]
        goal = Surface(first.vertices[0], first.faces)
        tracker = SurfaceTracker(last.faces, last.vertices.shape[1])
        vertices = tracker.drawn(last.vertices[-1], goal, spacing)
        if first.colors is None:
            return cls(vertices, None)
        return cls(vertices, first.colors[0, cKDTree(goal.vertices).query(vertices)[1]])


def write(selection: Selection, path: Path) -> None:
    """Write particles, and with `tracked` the surface, too; arguments as for `Format.write`.

    Raises:
        ResultError: The viewer is not built.
    """
    path.write_text(page(selection), encoding="utf-8")


def is_quick(trajectory: Trajectory, frames: Sequence[int] | None = None) -> bool:
    """Whether the surface of some frames, or of all, takes seconds; it is followed between them."""
    count = trajectory.frame_count
    chosen = range(count) if frames is None else {frame % count for frame in frames}
    if len(chosen) < 2:
        return False
    return (max(chosen) - min(chosen) + 1) * trajectory.run.particle_count <= QUICK


def embedded(trajectory: Trajectory) -> str | None:
    """A viewer to be put into another page, such as a notebook.

    None where it is not built, or the particles of a frame are lost. It shows the surface where
    that is quick, and else the particles alone.
    """
    selection = Selection(trajectory, tuple(range(trajectory.frame_count)))
    if not selection.frames or not VIEWER.is_dir():
        return None
    if is_quick(trajectory):
        selection = replace(selection, surface=True, tracked=True)
    try:
        whole = page(selection, most_bytes=NOTEBOOK_BYTES)
    except MeshError:
        return None
    return FRAME.format(page=html.escape(whole), title=html.escape(_title(trajectory)))


def page(selection: Selection, *, most_bytes: int = MOST_BYTES) -> str:
    """The file as text.

    Args:
        selection: As for `Format.write`.
        most_bytes: Size of all arrays before they are deflated. The surface takes half of them at
            most, by larger triangles if need be, and the particles take the rest: beyond it some
            are left out.

    Raises:
        ResultError: The viewer is not built, or a frame is damaged.
        MeshError: The particles of a frame are lost, or enclose nothing.
    """
    script, style, licenses = map(_built, ("viewer.js", "viewer.css", "licenses.txt"))
    selection = replace(selection, units="grid")
    frames = tuple(sorted(set(selection.frames)))
    trajectory = selection.trajectory
    within = _within_reach(trajectory, frames)
    timing = picture_table(trajectory, selection.timing) if selection.timing else None
    room = most_bytes - len(json.dumps(timing))
    closes = timing is not None and "closing" in timing
    stored = len(frames) + closes
    moving = POSITION_BYTES + COLOR_BYTES * (trajectory.colors is not None)
    surface = None
    if selection.tracked:
        still = MESHES * TRIANGLES_PER_VERTEX * TRIANGLE_BYTES
        limit = room // 2 // (moving * (stored + 1) + still)
        follow = track_surface if len(frames) > 1 else still_surface
        surface = follow(selection, vertex_limit=limit)
        room -= sum(_size(mesh) for mesh in surface.meshes)
        room -= closes * moving * surface.meshes[-1].vertices.shape[1]
    count = trajectory.run.particle_count
    shown = within[_some(len(within), max(room // (moving * stored), 1))]
    points = np.stack([selection.placed(trajectory.positions(f)[shown], f) for f in frames])
    colors = None
    if trajectory.colors is not None:
        found = [selection.particle_colors(frame) for frame in frames]
        colors = np.stack([rgb[shown] for rgb in found if rgb is not None])
    ends = [LoopEnd.of_points(points, colors)] if closes else []
    if closes and surface:
        spacing = trajectory.run.spacing_of(trajectory.positions(0))
        ends.append(LoopEnd.of_surface(surface, spacing))
    about, packed = pack(frames, points, surface, colors, ends)
    config, title = trajectory.config, _title(trajectory)
    some = "" if len(shown) == count else f" ({len(shown):,} shown)"
    about |= {
        "title": title,
        "words": f"{count:,} particles{some}, method {config.method.name}",
        "up": trajectory.run.placement.up,
        "spacing": config.spacing * (count / len(shown)) ** (1 / 3),
    }
    if timing:
        about["timing"] = timing
    return PAGE.format(
        title=html.escape(title),
        licenses=licenses,
        style=style,
        about=json.dumps(about).replace("<", "\\u003c"),
        frames=base64.b64encode(packed).decode("ascii"),
        script=script.replace("</script", "<\\/script"),
    )


def pack(
    frames: Sequence[int],
    points: Floats,
    surface: TrackedSurface | None,
    colors: npt.NDArray[np.uint8] | None = None,
    ends: Sequence[LoopEnd] = (),
) -> tuple[dict[str, Any], bytes]:
    """Positions and colours as the viewer takes them, and the document that describes them.

    Args:
        frames: Indices of the frames.
        points: Particles by frame [any unit], shape [T, n, 3].
        surface: Their surface in the same frames, if there is one.
        colors: Colours of the particles by frame, sRGB, shape [T, n, 3], if they have any.
        ends: Of a loop: where the particles go in the end, and the last mesh of a surface.
    """
    meshes = surface.meshes if surface else ()
    everything = [points, *(mesh.vertices for mesh in meshes)]
    everything += [end.positions[None] for end in ends]
    low = np.min([positions.min(axis=(0, 1)) for positions in everything], axis=0)
    high = np.max([positions.max(axis=(0, 1)) for positions in everything], axis=0)
    scale = float((high - low).max()) or 1.0

    def packed(positions: Floats) -> bytes:
        levels = np.rint((positions - low) / scale * LEVELS).astype(np.uint16)
        moved = np.diff(levels, axis=0, prepend=np.zeros_like(levels[:1]))  # modulo 65536
        return bytes(moved.astype("<u2").tobytes())

    def tinted(rgb: npt.NDArray[np.uint8] | None) -> bytes:
        return b"" if rgb is None else np.diff(rgb, axis=0, prepend=rgb[:1] * 0).tobytes()

    chunks: list[bytes] = []

    def moving(
        shown: Sequence[int],
        positions: Floats,
        rgb: npt.NDArray[np.uint8] | None,
        end: LoopEnd | None,
    ) -> dict[str, Any]:
        if end is not None:
            positions = np.concatenate([positions, end.positions[None]])
            if rgb is not None and end.colors is not None:
                rgb = np.concatenate([rgb, end.colors[None]])
        chunks.extend([packed(positions), tinted(rgb)])
        return {
            "frames": [frames.index(frame) for frame in shown],
            "count": positions.shape[1],
            "colored": rgb is not None,
            "closes": end is not None,
        }

    particles = moving(frames, points, colors, ends[0] if ends else None)
    described = []
    for mesh in meshes:
        end = ends[-1] if ends and mesh is meshes[-1] else None
        described.append(moving(mesh.frames, mesh.vertices, mesh.colors, end))
        described[-1]["triangles"] = len(mesh.faces)
        chunks.append(mesh.faces.astype("<u4").tobytes())
    about = {
        "frames": list(frames),
        "offset": low.tolist(),
        "scale": scale,
        "points": particles,
        "surfaces": described,
    }
    return about, zlib.compress(b"".join(chunks), 9)


def _size(mesh: TrackedMesh) -> int:
    """Bytes of a mesh in the file before they are deflated."""
    colors = 0 if mesh.colors is None else mesh.colors.size
    return mesh.vertices.size * POSITION_BYTES // 3 + colors + len(mesh.faces) * TRIANGLE_BYTES


def _title(trajectory: Trajectory) -> str:
    return " to ".join(trajectory.run.names)


def _within_reach(trajectory: Trajectory, frames: Sequence[int]) -> npt.NDArray[np.intp]:
    """Indices of the particles that a viewer can show in all frames.

    Those that are lost are nowhere, and one far away would leave the others no digits.

    Raises:
        MeshError: There are none.
    """
    within = np.ones(trajectory.particle_count, np.bool_)
    for frame in frames:
        positions = trajectory.positions(frame)
        here = known_points(positions, frame)
        known = np.flatnonzero(here)
        here[known] = are_near_the_middle(
            positions[known].astype(np.float64), trajectory.config.spacing
        )
        within &= here
    if not within.any():
        raise MeshError("Each particle is lost in one of the frames.", "Choose other frames.")
    return np.flatnonzero(within)


def _some(count: int, most: int) -> npt.NDArray[np.int64]:
    """Indices of so many particles at most, spread evenly: they are in no order in space."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def _built(name: str) -> str:
    try:
        return (VIEWER / name).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ResultError(
            "The viewer has not been built in this checkout.",
            "Run `make page`, which needs Node.js.",
        ) from None


FORMAT = Format(
    name="html",
    suffix=".html",
    kind="sequence",
    carries=frozenset({"points", "tracked"}),
    timed=True,
    media_type="text/html",
    description="One page with a viewer that works offline in any browser; embed it anywhere",
    write=write,
)
