"""The length of binary STL files, to which some programs append bytes of their own."""

from __future__ import annotations

COUNT_AT, TRIANGLES_AT, TRIANGLE_BYTES = 80, 84, 50
"""Where the number of triangles is, where they begin, and what each takes."""


def without_appendix(data: bytes) -> bytes:
    """A binary STL file as long as its header says; any other file as it is.

    The characters of a text at the place of the number would make it larger than any file.

    Args:
        data: The file.
    """
    count = int.from_bytes(data[COUNT_AT:TRIANGLES_AT], "little")
    end = TRIANGLES_AT + count * TRIANGLE_BYTES
    return data[:end] if count and end < len(data) else data
