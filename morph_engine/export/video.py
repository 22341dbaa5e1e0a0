"""MP4 and GIF: the frames as a video."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from morph_engine.export.format import Format
from morph_engine.rendering.pictures import video
from morph_engine.rendering.video_encoder import VideoKind
from morph_engine.results.selection import Selection

FRAMES_PER_SECOND = 12.0


def write(selection: Selection, path: Path, *, kind: VideoKind) -> None:
    """Write a video, coloured by the first field; other arguments as for `Format.write`."""
    video(
        selection.trajectory,
        path,
        field=selection.fields[0] if selection.fields else None,
        surface=selection.surface,
        snap=selection.snap,
        frames=selection.frames,
        fps=selection.fps or FRAMES_PER_SECOND,
        kind=kind,
        watch=selection.watch,
    )


MP4 = Format(
    name="mp4",
    suffix=".mp4",
    media_type="video/mp4",
    kind="sequence",
    carries=frozenset({"points", "surface", "fields"}),
    extra="video",
    description="A video, coloured by the first field; everywhere",
    write=partial(write, kind="mp4"),
)
GIF = Format(
    name="gif",
    suffix=".gif",
    media_type="image/gif",
    kind="sequence",
    carries=frozenset({"points", "surface", "fields"}),
    description="A short video in 256 colours; everywhere",
    write=partial(write, kind="gif"),
)
