"""Formats that hold one frame in a file: a file per frame in a zip archive or a folder."""

from __future__ import annotations

import zipfile
from pathlib import Path

from morph_engine.export.format import Format
from morph_engine.files import replacing
from morph_engine.results.selection import Selection

EARLIEST = (1980, 1, 1, 0, 0, 0)
"""What a zip archive can say earliest; the same export twice gives the same bytes."""


def write_archive(chosen: Format, selection: Selection, path: Path) -> None:
    """Write a zip archive with a file per frame; arguments as for `Format.write`."""
    total = len(selection.frames)
    part = path.with_name(path.name + chosen.suffix)
    try:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for done, frame in enumerate(selection.frames):
                selection.watch(done, total)
                chosen.write(selection.only(frame), part)
                entry = zipfile.ZipInfo(_name(chosen, frame), EARLIEST)
                entry.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(entry, "w") as file:
                    file.write(part.read_bytes())
    finally:
        part.unlink(missing_ok=True)
    selection.watch(total, total)


def write_folder(chosen: Format, selection: Selection, path: Path) -> None:
    """Write a file per frame into a folder, which is made; arguments as for `Format.write`."""
    total = len(selection.frames)
    path.mkdir(parents=True, exist_ok=True)
    for done, frame in enumerate(selection.frames):
        selection.watch(done, total)
        with replacing(path / _name(chosen, frame)) as temporary:
            chosen.write(selection.only(frame), temporary)
    selection.watch(total, total)


def _name(chosen: Format, frame: int) -> str:
    return f"frame-{frame:04d}{chosen.suffix}"
