"""What the object store has of a job: one small object that names all others.

A job's files are objects that are written once, under keys of their own, and the manifest says
which of them make up which file. It is replaced only by whoever has read its last version, so that
it is at the same time the directory of the job, the sign that something is new, and the fence
against a host that was cut off while another one went on with its job.
"""

from __future__ import annotations

from pydantic import BaseModel


class Piece(BaseModel, frozen=True):
    """A part of a file.

    Attributes:
        key: Last part of the key of its object.
        size: Its size [bytes].
    """

    key: str
    size: int


class Manifest(BaseModel):
    """The files of a job.

    Attributes:
        writer: Who may replace it, a name for each attempt.
        run: Which run of the job it is of: another one has nothing in common with it.
        files: Pieces of each file, in order, by its path in the folder of the job.
    """

    writer: str = ""
    run: str = ""
    files: dict[str, list[Piece]] = {}

    @property
    def size(self) -> int:
        """Size of all files [bytes]."""
        return sum(piece.size for pieces in self.files.values() for piece in pieces)

    @property
    def keys(self) -> set[str]:
        """Keys of all pieces."""
        return {piece.key for pieces in self.files.values() for piece in pieces}
