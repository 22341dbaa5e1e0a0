"""Meshes of several files in a ZIP archive: OBJ with MTL and pictures, glTF with its buffers."""

from __future__ import annotations

import base64
import io
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import PurePosixPath
from typing import Any
from unicodedata import normalize
from urllib.parse import unquote

from morph_engine.errors import MeshError
from morph_engine.files import UNREADABLE

FILES_LIMIT = 1000
"""Most files in an archive."""

HIDDEN = ("__MACOSX", ".")
"""What systems put into archives beside the user's files begins so."""

PICTURES = (".png", ".jpg", ".jpeg", ".webp")

UTF_8_NAME = 0x800
"""Flag of a file whose name is in UTF-8; macOS writes such names without it."""

REFERENCE_LIMIT = 500
"""Most characters at the end of a picture's options and path in which the path is looked for."""

Members = Mapping[str, bytes]
"""The files of an archive by their paths in it."""


def read_archive(data: bytes, name: str, kinds: Sequence[str], limit: int) -> tuple[str, Members]:
    """Unpack an archive that holds one mesh, in memory.

    Args:
        data: The archive.
        name: Its name, for messages.
        kinds: Suffixes of meshes.
        limit: Most bytes of all files together.

    Returns:
        The path of the mesh in it, and all files.

    Raises:
        MeshError: It is damaged, encrypted or too large, or does not hold exactly one mesh.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = _unpacked(archive, name, limit)
    except (OSError, *UNREADABLE) as error:
        raise MeshError(
            f"{name} is not a readable ZIP file.", "Create the archive again."
        ) from error
    found = sorted(path for path in members if PurePosixPath(path).suffix[1:].lower() in kinds)
    if not found:
        raise MeshError(
            f"{name} contains no mesh.", "Put an OBJ, PLY, STL, OFF, GLB or glTF file into it."
        )
    if len(found) > 1:
        raise MeshError(
            f"{name} contains {len(found)} meshes, such as {found[0]} and {found[1]}.",
            "Create one archive for each.",
        )
    return found[0], members


def _unpacked(archive: zipfile.ZipFile, name: str, limit: int) -> Members:
    infos = [info for info in archive.infolist() if not info.is_dir() and not _hidden(info)]
    if len(infos) > FILES_LIMIT:
        raise MeshError(
            f"{name} contains {len(infos)} files, more than {FILES_LIMIT}.",
            "Put only the mesh, its materials and their textures into it.",
        )
    if any(info.flag_bits & 1 for info in infos):
        raise MeshError(f"{name} is encrypted.", "Create the archive without a password.")
    members, room = {}, limit
    for info in infos:
        with archive.open(info) as file:
            content = file.read(room + 1)  # its size as stated may be wrong
        room -= len(content)
        if room < 0:
            raise MeshError(
                f"{name} contains more than {limit >> 20} MiB.",
                "Decimate the mesh and scale its textures down.",
            )
        members[_name(info)] = content
    return members


def _name(info: zipfile.ZipInfo) -> str:
    """Path of a file; letters with accents, which macOS takes apart, are one each."""
    name = info.filename
    if not info.flag_bits & UTF_8_NAME:
        with suppress(UnicodeError):  # else it is in the encoding that it says
            name = name.encode("cp437").decode("utf-8")
    return normalize("NFC", name.replace("\\", "/"))


def _hidden(info: zipfile.ZipInfo) -> bool:
    return any(part.startswith(HIDDEN) for part in PurePosixPath(info.filename).parts)


class Companions:
    """The files that the mesh of an archive may refer to: what trimesh calls a resolver.

    Exporters write paths of the machine that they ran on, in any case of letters: where there is no
    file of that path, one of that name serves.

    Args:
        members: All files.
        mesh: Path of the mesh.

    Attributes:
        missing: What has been looked for and is not there.
    """

    def __init__(self, members: Members, mesh: str) -> None:
        self.missing: list[str] = []
        self._members = members
        self._folder = PurePosixPath(mesh).parent
        self._by_name = {PurePosixPath(p).name.lower(): p for p in sorted(members, reverse=True)}

    @property
    def have_pictures(self) -> bool:
        """Whether there is a file that a texture may be."""
        return any(PurePosixPath(path).suffix.lower() in PICTURES for path in self._members)

    def find(self, reference: str) -> bytes | None:
        """The file that is meant by what the mesh says, such as ``textures/skin.png``."""
        possible = _possible_paths(normalize("NFC", reference.strip().replace("\\", "/")))
        by_name: dict[str, list[str]] = {}
        for path in possible:
            by_name.setdefault(PurePosixPath(path).name, []).append(path)
        for wanted, paths in by_name.items():
            in_folder = [str(self._folder / path) for path in paths]
            same_name = self._by_name.get(wanted.lower(), "")
            for path in (*in_folder, *paths, same_name):
                if path in self._members:
                    return self._members[path]
        self.missing.append(possible[-1])
        return None

    def get(self, reference: str) -> bytes:
        """The same.

        Raises:
            OSError: There is none.
        """
        content = self.find(reference)
        if content is None:
            raise FileNotFoundError(reference)
        return content

    __getitem__ = get


def _possible_paths(reference: str) -> list[str]:
    """What may be the path in a reference: an MTL has options before it, as in ``-s 1 1 1 a.png``.

    Paths have spaces as well, so that only the files tell where it begins.
    """
    if not reference.startswith("-"):
        return [reference]
    end = reference[-REFERENCE_LIMIT:]
    return [reference, *(end[word.start() :] for word in re.finditer(r"(?<=\s)\S+", end))]


def mesh_content(path: str, members: Members) -> bytes:
    """A mesh as it is to be read: a glTF with its files, an OBJ without comments on its MTL.

    Raises:
        MeshError: A buffer of a glTF is not in the archive.
    """
    kind = PurePosixPath(path).suffix.lower()
    if kind == ".gltf":
        return self_contained_gltf(path, members)
    if kind == ".obj":  # trimesh takes what follows the first mtllib, wherever it is
        return re.sub(rb"^[ \t]*#.*mtllib.*$", b"#", members[path], flags=re.MULTILINE)
    return members[path]


def self_contained_gltf(path: str, members: Members) -> bytes:
    """A glTF file whose buffers and pictures are in it.

    Raises:
        MeshError: A buffer is not in the archive.
    """
    header: dict[str, Any] = json.loads(members[path])
    companions = Companions(members, path)
    for kind in ("buffers", "images"):
        for item in header.get(kind, []):
            uri = item.get("uri", "data:")
            if uri.startswith("data:"):
                continue
            content = companions.find(unquote(uri))
            if content is not None:
                item["uri"] = f"data:;base64,{base64.b64encode(content).decode('ascii')}"
            elif kind == "buffers":
                raise MeshError(f"The archive lacks {uri}.", "Put it next to the glTF file.")
    return json.dumps(header).encode()
