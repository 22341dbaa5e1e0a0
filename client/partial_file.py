"""A file on its way: what has arrived of it, under a name that says of which version."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from glob import escape
from pathlib import Path

from morph_engine.errors import ResultError
from morph_engine.files import file_sha256

SUFFIX = ".part"

_DIGEST = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True)
class PartialFile:
    """What has arrived of a file, in `<name>.<digest>.part` beside it.

    Attributes:
        target: Where the whole file will be.
        digest: SHA-256 of the whole file.
    """

    target: Path
    digest: str

    @classmethod
    def find(cls, target: Path) -> PartialFile | None:
        """What an earlier attempt left behind; None if nothing."""
        for path in sorted(target.parent.glob(f"{escape(target.name)}.*{SUFFIX}")):
            digest = path.name[len(target.name) + 1 : -len(SUFFIX)]
            if _DIGEST.fullmatch(digest):
                return cls(target, digest)
        return None

    @classmethod
    def from_etag(cls, target: Path, etag: str) -> PartialFile | None:
        """The partial file of what a server sends under this ETag; None if it is no SHA-256."""
        digest = etag.strip('"')
        return cls(target, digest) if _DIGEST.fullmatch(digest) else None

    @property
    def path(self) -> Path:
        """The file that holds it."""
        return self.target.with_name(f"{self.target.name}.{self.digest}{SUFFIX}")

    @property
    def size(self) -> int:
        """Bytes that have arrived."""
        return self.path.stat().st_size if self.path.exists() else 0

    def discard(self) -> None:
        """Remove it."""
        self.path.unlink(missing_ok=True)

    def complete(self) -> None:
        """Make it the whole file, in one step.

        Raises:
            ResultError: Its digest is another one; it is gone then.
        """
        if file_sha256(self.path) != self.digest:
            self.discard()
            raise ResultError(
                f"{self.target.name} arrived damaged: its SHA-256 is not the one announced.",
                "Fetch it again.",
            )
        os.replace(self.path, self.target)
