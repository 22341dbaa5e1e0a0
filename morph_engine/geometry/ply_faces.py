"""Binary PLY files with polygons, as Blender writes them: trimesh reads only those of one size."""

from __future__ import annotations

import io
import struct
from array import array
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Lengths = tuple[int, ...]
"""Of the lists in a row."""

Rows = Mapping[Lengths, Sequence[int] | npt.NDArray[np.int64]]
"""Where rows begin in a file, by the lengths of their lists."""

CODES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I",
    "float": "f", "double": "d", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float16": "e", "float32": "f",
    "float64": "d",
}  # fmt: skip
"""Types of PLY, as `struct` and NumPy call them."""

COUNT_CODES = {name: code.upper() for name, code in CODES.items() if code in "bBhHiIqQ"}
"""Of the lengths of lists: none is negative, so that a damaged one is beyond the file's end."""

CORNER_LISTS = ("vertex_indices", "vertex_index")

GROWTH_LIMIT = 16
"""Most bytes of triangles for a byte of the file; quads with colours take 2, large polygons 4."""


@dataclass(frozen=True)
class _Property:
    """A number in each row, or a list of numbers after their count."""

    name: str
    code: str
    count_code: str = ""


@dataclass(frozen=True)
class _Element:
    """Rows with the same properties."""

    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def lists(self) -> list[_Property]:
        return [one for one in self.properties if one.count_code]

    @property
    def corners(self) -> _Property | None:
        """The list of a polygon's corners."""
        named = (one for one in self.lists if one.name in CORNER_LISTS)
        return next(named, self.lists[0] if len(self.lists) == 1 else None)

    def row(self, lengths: Lengths, order: str) -> np.dtype[np.void]:
        """A row with lists of these lengths; fields are called by their places in it."""
        left = iter(lengths)
        fields: list[tuple[str, str, tuple[int, ...]]] = []
        for k, one in enumerate(self.properties):
            if one.count_code:
                fields.append((f"count {k}", order + one.count_code, ()))
            fields.append((str(k), order + one.code, (next(left),) if one.count_code else ()))
        return np.dtype(fields)


def with_triangles(data: bytes) -> bytes:
    """A PLY file whose polygons are cut into triangles, each with the numbers of its polygon.

    Lists other than that of the corners, such as places in a texture, are then left out; polygons
    of one size that have such lists stay, since trimesh reads them.

    Args:
        data: The file.

    Returns:
        The file; the same object where it is not binary, or trimesh reads it right.

    Raises:
        ValueError: It is damaged.
    """
    file = io.BytesIO(data)
    lines = [file.readline(), file.readline()]
    if not lines[0].startswith(b"ply") or b"binary" not in lines[1]:
        return data
    while lines[-1].split() != [b"end_header"]:
        lines.append(file.readline())
        if not lines[-1]:
            raise ValueError("The header has no end.")
    order = ">" if b"big" in lines[1] else "<"
    start = place = file.tell()
    for element in _elements(lines):
        rows, end = _rows(data, element, place, order)
        if element.name == "face" and element.corners:
            if len(rows) < 2 and all(len(key) > 1 or key == (3,) for key in rows):
                return data
            faces = _triangles(data, element, rows, order)
            head = b"".join(_header(lines, len(faces)))
            return b"".join((head, data[start:place], faces.tobytes(), data[end:]))
        place = end
    return data


def _elements(lines: Iterable[bytes]) -> list[_Element]:
    """What a header says about the rows that follow it."""
    elements: list[_Element] = []
    for line in lines:
        words = line.decode("utf-8").split()
        try:
            match words:
                case ["element", name, count]:
                    elements.append(_Element(name, max(int(count), 0)))
                case ["property", "list", count_type, kind, name] if elements:
                    one = _Property(name, CODES[kind], COUNT_CODES[count_type])
                    elements[-1].properties.append(one)
                case ["property", kind, name] if elements:
                    elements[-1].properties.append(_Property(name, CODES[kind]))
        except KeyError as error:
            raise ValueError(f"A property has the unknown type {error}.") from None
    return elements


def _rows(data: bytes, element: _Element, start: int, order: str) -> tuple[Rows, int]:
    """Where the rows of an element with lists begin, and where any element ends."""
    if not element.count:
        return {}, start
    if not element.lists:
        return {}, start + element.count * element.row((), order).itemsize
    first, _ = _walk(data, element, 1, start, order)
    (lengths,) = first
    row = element.row(lengths, order)
    end = start + element.count * row.itemsize
    if end <= len(data):
        rows = np.frombuffer(data, row, element.count, start)
        counts = [name for name in row.names or () if name.startswith("count")]
        if all((rows[name] == n).all() for name, n in zip(counts, lengths, strict=True)):
            return {lengths: np.arange(start, end, row.itemsize)}, end
    return _walk(data, element, element.count, start, order)


def _walk(data: bytes, element: _Element, count: int, place: int, order: str) -> tuple[Rows, int]:
    """Go through so many rows, one after the other.

    Raises:
        ValueError: They end beyond the file.
    """
    gap, steps = 0, []
    for one in element.properties:
        size = struct.calcsize(order + one.code)
        if one.count_code:
            number = struct.Struct(order + one.count_code)
            steps.append((gap, number.unpack_from, number.size, size))
        gap = 0 if one.count_code else gap + size
    rows: defaultdict[Lengths, array[int]] = defaultdict(lambda: array("q"))
    try:
        for _ in range(count):
            start, lengths = place, ()
            for before, unpack, width, size in steps:
                place += before
                length = unpack(data, place)
                place += width + length[0] * size
                lengths += length
            place += gap
            rows[lengths].append(start)
    except (struct.error, OverflowError):
        place = len(data) + 1
    if place > len(data):
        raise ValueError("The file ends within its rows.")
    return rows, place


def _triangles(data: bytes, element: _Element, rows: Rows, order: str) -> npt.NDArray[np.void]:
    """Polygons of a face element, each cut into a fan of triangles around its first corner."""
    assert element.corners
    which = element.lists.index(element.corners)
    corners = str(element.properties.index(element.corners))
    kept = [(str(k), one.code) for k, one in enumerate(element.properties) if not one.count_code]
    layout = [("count", "u1"), ("corners", order + "i4", 3), *((k, order + c) for k, c in kept)]
    count = sum(len(places) * max(lengths[which] - 2, 0) for lengths, places in rows.items())
    if count * np.dtype(layout).itemsize > GROWTH_LIMIT * len(data):
        raise ValueError("Polygons have more corners than a mesh has.")
    faces = np.empty(count, layout)
    faces["count"] = 3
    content, start = np.frombuffer(data, np.uint8), 0
    for lengths, places in rows.items():
        row = element.row(lengths, order)
        shape = (len(places), max(lengths[which] - 2, 0))
        fans = faces[start : start + shape[0] * shape[1]].reshape(shape)
        start += fans.size
        found = np.lib.stride_tricks.sliding_window_view(content, row.itemsize)[places]
        polygons = found.view(row)
        around = polygons[corners][:, 0]
        fans["corners"][..., 0] = around[:, :1]
        fans["corners"][..., 1] = around[:, 1:-1]
        fans["corners"][..., 2] = around[:, 2:]
        for name, _ in kept:
            fans[name] = polygons[name]
    return faces


def _header(lines: Iterable[bytes], count: int) -> Iterator[bytes]:
    """A header, in which the faces are so many triangles."""
    in_faces = False
    for line in lines:
        words = line.split()
        if words[:1] == [b"element"]:
            in_faces = words[1:2] == [b"face"]
            if in_faces:
                yield b"element face %d\nproperty list uchar int vertex_indices\n" % count
                continue
        if not (in_faces and words[:2] == [b"property", b"list"]):
            yield line
