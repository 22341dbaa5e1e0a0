"""Lists of SHA-256 digests in the format of `sha256sum`, which checks them, too."""

from __future__ import annotations

import re
from pathlib import Path

from morph_engine.errors import MeshError
from morph_engine.files import replacing

_LINE = re.compile(r"([0-9a-fA-F]{64}) [ *](.+)")


def read_checksums(path: Path) -> dict[str, str]:
    """Digest by file name; none where there is no such list.

    Raises:
        MeshError: A line is none of `sha256sum`, or the list cannot be read.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError) as error:
        raise _unreadable(path) from error
    matches = [_LINE.fullmatch(line) for line in lines if line.strip()]
    if None in matches:
        raise _unreadable(path)
    return {match[2]: match[1].lower() for match in matches if match}


def write_checksums(path: Path, digests: dict[str, str]) -> None:
    """Write a list in one step, sorted by name.

    Raises:
        OSError: It cannot be written.
    """
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def _unreadable(path: Path) -> MeshError:
    return MeshError(
        f"{path} is not a list of SHA-256 digests.",
        "Each line is 64 hexadecimal digits, two spaces and a file name, as sha256sum writes it.",
    )
