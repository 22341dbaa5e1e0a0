"""One file out of an archive, ZIP or gzipped TAR, which is read and never unpacked to the disk."""

from __future__ import annotations

import gzip
import tarfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from morph_engine.errors import MeshError

FILE_LIMIT = 128 * 2**20
"""Most bytes of the file that is read."""

ARCHIVE_LIMIT = 512 * 2**20
"""Most bytes that a compressed TAR archive may unfold to."""

_BLOCK_BYTES = 1 << 20


def read_member(archive: Path, name: str) -> bytes:
    """The first regular file of an archive that has a name, in whichever folder of it.

    Raises:
        MeshError: It is no whole ZIP or gzipped TAR archive, has no such file, or a file too large.
        OSError: The archive cannot be read.
    """
    try:
        if zipfile.is_zipfile(archive):
            return _from_zip(archive, name)
        return _from_tar(archive, name)
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, NotImplementedError) as e:
        raise _damaged(archive) from e
    except OSError as error:
        if error.errno is None:  # gzip's own, of a damaged file
            raise _damaged(archive) from error
        raise


def _from_zip(path: Path, name: str) -> bytes:
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            if not entry.is_dir() and PurePosixPath(entry.filename).name == name:
                if entry.file_size > FILE_LIMIT:
                    raise _too_large(path, name)
                with archive.open(entry) as file:
                    return file.read(FILE_LIMIT)
    raise _absent(path, name)


def _from_tar(path: Path, name: str) -> bytes:
    """Read the archive to its end, where its checksum is."""
    content = None
    with gzip.open(path) as stream:
        with tarfile.open(fileobj=stream, mode="r|") as archive:
            for entry in archive:
                if entry.offset_data + entry.size > ARCHIVE_LIMIT:
                    raise _too_large(path, name)
                if entry.isfile() and PurePosixPath(entry.name).name == name:
                    file = archive.extractfile(entry)
                    if file is None or entry.size > FILE_LIMIT:
                        raise _too_large(path, name)
                    content = file.read()
                    break
        while stream.read(_BLOCK_BYTES):
            if stream.tell() > ARCHIVE_LIMIT:
                raise _too_large(path, name)
    if content is None:
        raise _absent(path, name)
    return content


def _damaged(path: Path) -> MeshError:
    return MeshError(
        f"{path.name} is not a complete ZIP or gzipped TAR archive.", "Fetch it again."
    )


def _absent(path: Path, name: str) -> MeshError:
    return MeshError(f"There is no {name} in {path.name}.", "Use the archive that its author made.")


def _too_large(path: Path, name: str) -> MeshError:
    return MeshError(
        f"{path.name} is too large when unpacked to look for {name} in it.",
        "Use the archive that its author made.",
    )
