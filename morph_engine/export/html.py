"""HTML: the frames and a viewer in one file, which a browser opens without a service or a network.

The file holds positions as 16-bit shares of the box around all of them, as differences from frame
to frame, deflated, in base64, and so are colours, as bytes. `server/web/src/standalone/film.js`
unpacks them.
"""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from morph_engine.errors import ResultError
from morph_engine.export.format import Format
from morph_engine.results.playback import picture_table
from morph_engine.results.selection import Selection
from morph_engine.results.tracked_surface import TrackedSurface, track_surface
from morph_engine.results.trajectory import Trajectory

Floats = npt.NDArray[np.float64]

VIEWER = Path(__file__).parent / "viewer"
"""Script and style sheet of the viewer, and the licences of the libraries in it, which
`npm run build` in server/web makes."""

LEVELS = 65535
"""Largest 16-bit share."""

MOST_VALUES = 6_000_000
"""Of coordinates in a file, for particles and for the surface: 12 MB before they are deflated, so
that a file stays below 15 MB."""

NOTEBOOK_VALUES = 1_000_000
"""The same of what a notebook displays, which is stored in it."""

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


def write(selection: Selection, path: Path) -> None:
    """Write particles, and with `tracked` the surface, too; arguments as for `Format.write`.

    Raises:
        ResultError: The viewer is not built.
    """
    path.write_text(page(selection), encoding="utf-8")


def embedded(trajectory: Trajectory) -> str | None:
    """A viewer to be put into another page, such as a notebook; None where it is not built."""
    selection = Selection(trajectory, tuple(range(trajectory.frame_count)))
    if not selection.frames or not VIEWER.is_dir():
        return None
    whole = page(selection, most_values=NOTEBOOK_VALUES)
    return FRAME.format(page=html.escape(whole), title=html.escape(_title(trajectory)))


def page(selection: Selection, *, most_values: int = MOST_VALUES) -> str:
    """The file as text.

    Args:
        selection: As for `Format.write`.
        most_values: Coordinates of particles, and of the surface; beyond it some are left out.

    Raises:
        ResultError: The viewer is not built, or a frame is damaged.
        MeshError: The particles of a frame enclose nothing.
    """
    script, style, licenses = map(_built, ("viewer.js", "viewer.css", "licenses.txt"))
    selection = replace(selection, units="grid")
    frames = tuple(sorted(set(selection.frames)))
    trajectory, limit = selection.trajectory, most_values // (3 * len(frames))
    surface = None
    if selection.tracked and len(frames) > 1:
        surface = track_surface(selection, vertex_limit=limit)
    count = trajectory.run.particle_count
    shown = _some(count, limit)
    points = np.stack([selection.placed(trajectory.positions(f)[shown], f) for f in frames])
    colors = None
    if trajectory.colors is not None:
        found = [selection.particle_colors(frame) for frame in frames]
        colors = np.stack([rgb[shown] for rgb in found if rgb is not None])
    about, packed = pack(frames, points, surface, colors)
    config, title = trajectory.config, _title(trajectory)
    some = "" if len(shown) == count else f" ({len(shown):,} shown)"
    about |= {
        "title": title,
        "words": f"{count:,} particles{some}, method {config.method.name}",
        "up": trajectory.run.placement.up,
        "spacing": config.spacing * (count / len(shown)) ** (1 / 3),
    }
    if selection.timing:
        about["timing"] = picture_table(trajectory, selection.timing)
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
) -> tuple[dict[str, Any], bytes]:
    """Positions and colours as the viewer takes them, and the document that describes them.

    Args:
        frames: Indices of the frames.
        points: Particles by frame [any unit], shape [T, n, 3].
        surface: Their surface in the same frames, if there is one.
        colors: Colours of the particles by frame, sRGB, shape [T, n, 3], if they have any.
    """
    meshes = surface.meshes if surface else ()
    everything = [points, *(mesh.vertices for mesh in meshes)]
    low = np.min([positions.min(axis=(0, 1)) for positions in everything], axis=0)
    high = np.max([positions.max(axis=(0, 1)) for positions in everything], axis=0)
    scale = float((high - low).max()) or 1.0

    def packed(positions: Floats) -> bytes:
        levels = np.rint((positions - low) / scale * LEVELS).astype(np.uint16)
        moved = np.diff(levels, axis=0, prepend=np.zeros_like(levels[:1]))  # modulo 65536
        return bytes(moved.astype("<u2").tobytes())

    def tinted(rgb: npt.NDArray[np.uint8] | None) -> bytes:
        return b"" if rgb is None else np.diff(rgb, axis=0, prepend=rgb[:1] * 0).tobytes()

    chunks = [packed(points), tinted(colors)]
    described = []
    for mesh in meshes:
        chunks += [packed(mesh.vertices), tinted(mesh.colors), mesh.faces.astype("<u4").tobytes()]
        described.append({
            "frames": [frames.index(frame) for frame in mesh.frames],
            "count": mesh.vertices.shape[1],
            "triangles": len(mesh.faces),
            "colored": mesh.colors is not None,
        })  # fmt: skip
    about = {
        "frames": list(frames),
        "offset": low.tolist(),
        "scale": scale,
        "points": {
            "frames": list(range(len(frames))),
            "count": points.shape[1],
            "colored": colors is not None,
        },
        "surfaces": described,
    }
    return about, zlib.compress(b"".join(chunks), 9)


def _title(trajectory: Trajectory) -> str:
    return " to ".join(trajectory.run.names)


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
            "The viewer is not built in this checkout.", "Run `make page`, which needs Node.js."
        ) from None


FORMAT = Format(
    name="html",
    suffix=".html",
    kind="sequence",
    carries=frozenset({"points", "tracked"}),
    timed=True,
    media_type="text/html",
    description="One page with a viewer for any browser, which needs no network; embed it anywhere",
    write=write,
)
