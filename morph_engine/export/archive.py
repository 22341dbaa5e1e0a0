"""Formats that hold one frame in a file: a file per frame in a zip archive or a folder."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

from morph_engine.export.format import Format
from morph_engine.files import replacing_frames
from morph_engine.results.selection import Selection

EARLIEST = (1980, 1, 1, 0, 0, 0)
"""What a zip archive can say earliest; the same export twice gives the same bytes."""


def write_archive(chosen: Format, selection: Selection, path: Path) -> None:
    """Write a zip archive with a file per frame; arguments as for `Format.write`."""
    part = path.with_name(path.name + chosen.suffix)
    try:
        with zipfile.ZipFile(path, "w") as archive:
            for name, frame in _files(chosen, selection):
                chosen.write(frame, part)
                entry = zipfile.ZipInfo(name, EARLIEST)
                archive.writestr(entry, part.read_bytes(), zipfile.ZIP_DEFLATED)
    finally:
        part.unlink(missing_ok=True)


def write_folder(chosen: Format, selection: Selection, path: Path) -> None:
    """Write a file per frame into a folder, see `replacing_frames`; else as `write_archive`."""
    with replacing_frames(path) as temporary:
        for name, frame in _files(chosen, selection):
            chosen.write(frame, temporary(name))


def _files(chosen: Format, selection: Selection) -> Iterator[tuple[str, Selection]]:
    """The name of each frame's file, and the selection of that frame alone; watched."""
    total = len(selection.frames)
    for done, frame in enumerate(selection.frames):
        selection.watch(done, total)
        yield f"frame-{frame:04d}{chosen.suffix}", selection.only(frame)
    selection.watch(total, total)
