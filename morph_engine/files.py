"""Files that survive a crash: replaced as a whole, and written by one process at a time.

Meshes and results are known by the SHA-256 of their files.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

POLL_SECONDS = 0.1

UNREADABLE = (
    EOFError, KeyError, RuntimeError, TypeError, ValueError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading a damaged archive of arrays (.npz) raises: a single bit may call it encrypted."""

_BLOCK_BYTES = 1 << 20

FRAME_FILE = re.compile(r"frame-\d{4,}\.(?:ply|obj|glb|stl|png)")
"""What a file in a folder with one per frame is called."""

LONGEST_STEM = 150
"""Of a file name that a program makes up [bytes]: file systems take 255, with all endings."""


def morph_stem(shapes: Iterable[str], *, partial: bool) -> str:
    """What to call files of a morph of these shapes: sphere-to-bunny, at most `LONGEST_STEM`."""
    plain = (re.sub(r"\W+", "-", Path(shape).stem).strip("-") or "shape" for shape in shapes)
    stem = "-to-".join(plain).encode()[:LONGEST_STEM].decode(errors="ignore").rstrip("-")
    return f"{stem}-partial" if partial else stem


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file so that readers see the old content or the new one, never a part of it.

    The body writes to the temporary name it is given, in the same directory. Leaving the body
    flushes that file to the disk and renames it over `path`; an exception removes it.

    Raises:
        OSError: The file cannot be written, for want of space or of the right to.
    """
    temporary = path.with_name(path.name + ".tmp")
    try:
        yield temporary
        with temporary.open("r+b") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_directory(path.parent)


@contextmanager
def replacing_frames(folder: Path) -> Iterator[Callable[[str], Path]]:
    """Write files of frames into a folder, which is made: all are there at the end, or none.

    The body asks for the temporary name of each file and writes to it. Leaving the body renames
    them, and removes files of other frames that are there from before; an exception removes the
    temporary ones. What is not called as frames are stays in any case.

    Raises:
        OSError: The files cannot be written, for want of space or of the right to.
    """
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    written: dict[str, Path] = {}

    def temporary(name: str) -> Path:
        return written.setdefault(name, folder / f"{name}.tmp")

    try:
        yield temporary
        for path in written.values():
            with path.open("r+b") as file:
                os.fsync(file.fileno())
        for old in list(folder.iterdir()):
            if FRAME_FILE.fullmatch(old.name) and old.name not in written:
                old.unlink()
        for name, path in written.items():
            os.replace(path, folder / name)
    finally:
        for path in written.values():
            path.unlink(missing_ok=True)
        if made and not any(folder.iterdir()):
            folder.rmdir()
    sync_directory(folder)


def sync_directory(path: Path) -> None:
    """Make the names in a directory durable, so that a rename outlives a power cut.

    Raises:
        OSError: The directory cannot be opened.
    """
    if sys.platform == "win32":
        return  # Windows cannot open a directory, and keeps names in its own journal
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def acquire(path: Path) -> BinaryIO | None:
    """Lock a file, created where missing, until it is closed; None where another process holds it.

    The system frees the lock when this process ends, however it ends.

    Raises:
        OSError: The lock file cannot be opened.
    """
    file = path.open("a+b")
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    if not path.exists():  # its holder removed it between our open and our lock
        file.close()
        return None
    return file


def wait_for(path: Path, seconds: float = float("inf")) -> BinaryIO:
    """Lock a file as soon as its holder lets go of it, see `acquire`; wait at most so long [s].

    Raises:
        TimeoutError: Its holder does not let go.
        OSError: The lock file cannot be opened.
    """
    deadline = time.monotonic() + seconds
    while (lock := acquire(path)) is None:
        if time.monotonic() > deadline:
            raise TimeoutError(f"{path} is in use by another process.")
        time.sleep(POLL_SECONDS)
    return lock


def file_sha256(path: Path) -> str:
    """Digest of a file's bytes, in hexadecimal, read block by block.

    Raises:
        OSError: The file cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()
