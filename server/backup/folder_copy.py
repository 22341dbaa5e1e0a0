"""A copy of a folder to which others are writing."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Set
from contextlib import suppress
from pathlib import Path, PurePath

FIRST = "checkpoint.npz"
"""Refers to frames beside it, so that it is copied before those which are written meanwhile."""


class FolderCopy:
    """Copies a folder, again and again; what the copy has already is left as it is.

    Each file is copied whole or not at all. Files that are the same in size and time of change are
    taken for the same: the service replaces files, or appends to them.

    Args:
        source: The folder; others may write to it.
        target: The copy; nobody else does.
        skipped: Names of files and folders that are left out, wherever they are.
        on_copied: Called with the size of each file that was copied [bytes].
    """

    def __init__(
        self, source: Path, target: Path, skipped: Set[str], on_copied: Callable[[int], None]
    ) -> None:
        self._source = source
        self._target = target
        self._skipped = skipped
        self._on_copied = on_copied
        self._seen: set[PurePath] = set()

    def update(self) -> None:
        """Copy what is new or has changed.

        Raises:
            OSError: A file cannot be read, or the disk of the copy refuses.
        """
        for name in _files(self._source, self._skipped):
            self._seen.add(name)
            with suppress(FileNotFoundError):  # it was deleted, or has become part of another
                self._copy(name)

    def remove_others(self) -> None:
        """Delete from the copy what no update has seen: what was deleted before the first one.

        Raises:
            OSError: The disk of the copy refuses.
        """
        for name in _files(self._target, frozenset()):
            if name not in self._seen:
                (self._target / name).unlink()
        for folder, _, _ in os.walk(self._target, topdown=False):
            with suppress(OSError):  # it is not empty
                os.rmdir(folder)

    def _copy(self, name: PurePath) -> None:
        source, target = self._source / name, self._target / name
        if _stamp(source) == _stamp(target):
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        part = target.with_name(target.name + ".part")
        try:
            with source.open("rb") as reader, part.open("wb") as writer:
                before = os.fstat(reader.fileno())
                shutil.copyfileobj(reader, writer, 1 << 20)
            os.utime(part, ns=(before.st_atime_ns, before.st_mtime_ns))
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
        self._on_copied(target.stat().st_size)


def folder_size(folder: Path) -> tuple[int, int]:
    """Number of files in a folder and those in it, and their bytes."""
    sizes = [(folder / name).stat().st_size for name in _files(folder, frozenset())]
    return len(sizes), sum(sizes)


def _files(folder: Path, skipped: Set[str]) -> Iterator[PurePath]:
    """Files below a folder, relative to it."""
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(set(folders) - skipped)
        for file in sorted(set(files) - skipped, key=lambda name: (name != FIRST, name)):
            yield PurePath(place).relative_to(folder) / file


def _stamp(path: Path) -> tuple[int, int] | None:
    """Size [bytes] and time of the last change [ns]; None where there is no such file."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_size, status.st_mtime_ns
