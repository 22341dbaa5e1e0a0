"""MP4, WebM, ProRes, GIF and PNG: the frames as a video."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from morph_engine.export.format import Format
from morph_engine.rendering.picture_options import PictureOptions
from morph_engine.rendering.pictures import video
from morph_engine.rendering.video_encoder import TRANSPARENT_KINDS, VideoKind
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
        frames=None if selection.timing else selection.frames,
        fps=selection.fps or FRAMES_PER_SECOND,
        timing=selection.timing,
        kind=kind,
        **vars(selection.picture or PictureOptions()),
        watch=selection.watch,
    )


def _format(
    name: VideoKind,
    media_type: str,
    description: str,
    *,
    suffix: str = "",
    extra: str | None = None,
) -> Format:
    return Format(
        name=name,
        suffix=suffix or f".{name}",
        media_type=media_type,
        kind="sequence",
        carries=frozenset({"points", "surface", "fields", "picture"})
        | ({"transparency"} if name in TRANSPARENT_KINDS else frozenset()),
        timed=True,
        extra=extra,
        description=description,
        write=partial(write, kind=name),
    )


MP4 = _format(
    "mp4", "video/mp4", "A video, coloured by the first field; plays everywhere", extra="video"
)
WEBM = _format(
    "webm", "video/webm", "A video (VP9), coloured by the first field; browsers", extra="video"
)
MOV = _format(
    "mov",
    "video/quicktime",
    "A video for editing (ProRes 4444), coloured by the first field",
    extra="video",
)
GIF = _format("gif", "image/gif", "A short video in 256 colours; plays everywhere")
PNG = _format(
    "png",
    "application/zip",
    "One picture per frame in a zip archive; any program",
    suffix=".zip",
)
