"""OBJ files made plain: absolute indices and one form of faces, such that trimesh reads them right.

trimesh finds a line by what it begins with, so that a byte order mark, a tab, an indentation or a
comment behind the numbers hides it. It tells the forms of faces apart by how many numbers a line
has, so that a hexagon ``f 1 2 3 4 5 6`` and a triangle ``f 1//1 2//1 3//1`` are one to it.
"""

from __future__ import annotations

import re

_UNUSUAL = re.compile(rb"(?m)\t|^ |^(?:v|vt|vn|f) [^#\n]*#")
_COMMENT = re.compile(rb"(?m)^((?:v|vt|vn|f) [^#\n]*)#.*$")
_FACE = re.compile(rb"(?m)^f .*$")
_ZERO = re.compile(rb"(?m)^f (?:.*[ /])?0(?:[ /\r]|$)")
_RELATIVE = re.compile(rb"(?m)^f .*-[0-9]")
_FORMS = {
    form: re.compile(rb"(?m)^f +" + corner + rb"[ \r\n]")
    for form, corner in {
        "v": rb"\d+", "v/vt": rb"\d+/\d+/?", "v//vn": rb"\d+//\d+", "v/vt/vn": rb"\d+/\d+/\d+"
    }.items()
}  # fmt: skip


def plain_obj(data: bytes) -> bytes:
    """The same mesh, its lines as trimesh expects them.

    Raises:
        IndexError: A face has the index 0; OBJ counts from one.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    if _UNUSUAL.search(data):
        data = re.sub(rb"(?m)^ +", b"", data.replace(b"\t", b" "))
        data = _COMMENT.sub(rb"\1", data)
    if _ZERO.search(data):
        raise IndexError("OBJ counts vertices from one")
    if _RELATIVE.search(data):
        data = _absolute(data)
    forms = [form for form, found in _FORMS.items() if found.search(data)]
    if len(forms) > 1:
        textured = any("vt" in form for form in forms)
        data = _FACE.sub(lambda face: _in_one_form(face[0], textured=textured), data)
    return data


def has_vertex_colors(data: bytes) -> bool:
    """Whether vertices have three numbers beside their positions."""
    return re.search(rb"(?m)^v(?: +[-+.\deE]+){6} *\r?$", data) is not None


def _absolute(data: bytes) -> bytes:
    """The same with indices that count from the beginning, in place of those that count back."""
    kinds = (b"v", b"vt", b"vn")
    counts = dict.fromkeys(kinds, 0)
    lines = data.split(b"\n")
    for number, line in enumerate(lines):
        kind = line[:2].rstrip()
        if kind in counts:
            counts[kind] += 1
        elif kind == b"f":
            so_far = [counts[each] for each in kinds]
            corners = [_counted(corner, so_far) for corner in line.split()[1:]]
            lines[number] = b" ".join([b"f", *corners])
    return b"\n".join(lines)


def _counted(corner: bytes, so_far: list[int]) -> bytes:
    """One corner of a face, such as ``-1/-1``, where so many of each kind have been read."""
    parts = []
    for part, count in zip(corner.split(b"/"), so_far, strict=False):
        if part.startswith(b"-"):
            index = count + 1 + int(part)
            if index < 1:
                raise IndexError("a face counts back beyond the first vertex")
            part = b"%d" % index
        parts.append(part)
    return b"/".join(parts)


def _in_one_form(face: bytes, *, textured: bool) -> bytes:
    """A face without normals; a corner that lacks texture coordinates has the first ones."""
    corners = [corner.split(b"/") for corner in face.split()[1:]]
    if not textured:
        return b" ".join([b"f", *(corner[0] for corner in corners)])
    places = [corner[1] if corner[1:2] > [b""] else b"1" for corner in corners]
    return b" ".join(
        [b"f", *(b"%s/%s" % (c[0], at) for c, at in zip(corners, places, strict=True))]
    )
