"""Built-in shapes, so that everything runs with no file at hand.

Each has the volume of the paper's sphere (an icosphere of circumradius 7.25), so that any two of
them hold nearly the same number of particles, and is centred in the domain, y upwards, facing z.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt
import scipy

from morph_engine import kept_results
from morph_engine.errors import MeshError, unknown_name
from morph_engine.geometry.mesh import FORMATS, TEXT_PREFIX, Mesh, load_mesh, make_mesh
from morph_engine.geometry.sampling import fit_to_domain
from morph_engine.optional_packages import require

trimesh: Any = lazy.load("trimesh")

TEXT_LIMIT = 60

Floats = npt.NDArray[np.float64]


def names() -> tuple[str, ...]:
    """Names of the built-in shapes; beside them, `text:ANY STRING` makes extruded letters."""
    return tuple(_SHAPES)


def make(name: str) -> Mesh:
    """Make a built-in shape [grid units]: one of `names()`, or `text:` and the text.

    Raises:
        MeshError: There is no such shape, or a text that cannot be drawn.
        ExtraError: It is a text, and what draws it is not installed.
    """
    if name.startswith(TEXT_PREFIX):
        raw = _arrays(_text(name.removeprefix(TEXT_PREFIX)))
    elif name in _SHAPES:
        raw = kept_results.kept("shape", (name,), lambda: _arrays(_SHAPES[name]()))
    else:
        raise unknown_name("built-in shape", name, names(), error=MeshError)
    mesh = make_mesh(raw["vertices"], raw["faces"], name=name)
    return replace(fit_to_domain(mesh, mode="volume")[0], built_in=True, up="y")


def _arrays(mesh: Mesh) -> kept_results.Arrays:
    return {"vertices": mesh.vertices, "faces": mesh.faces}


def resolve_shape(spec: str) -> Mesh:
    """Turn what a user typed into a mesh: a built-in name, `text:...` or the path of a file.

    Built-in shapes are in grid units, others in the coordinates of their files. A file without an
    ending of meshes does not hide a built-in shape of its name.

    Raises:
        MeshError: It is neither, or the mesh is unusable.
        ExtraError: It is a text, and what draws it is not installed.
    """
    known = Path(spec).suffix[1:].lower() in FORMATS
    if spec.startswith(TEXT_PREFIX) or spec in _SHAPES or not (known or Path(spec).is_file()):
        return make(spec)
    return load_mesh(spec)


def _sphere() -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=4)
    return make_mesh(ball.vertices, ball.faces, name="sphere")


def _torus() -> Mesh:
    torus = trimesh.creation.torus(8.0, 3.0, major_sections=96, minor_sections=48)
    return make_mesh(torus.vertices, torus.faces, name="torus")


def _heart() -> Mesh:
    """Taubin's heart, (x^2 + y^2 + 9/4 z^2 - 1)^3 = (x^2 + 9/80 z^2) y^3, ray by ray.

    On a ray of direction d it reads a r^2 - 1 = c r^(5/3), which has one positive root.
    """
    ball = trimesh.creation.icosphere(subdivisions=5)
    x, y, z = ball.vertices.T
    a = x**2 + y**2 + 9 / 4 * z**2
    c = np.cbrt((x**2 + 9 / 80 * z**2) * y**3)
    lower, upper = np.zeros_like(x), np.full_like(x, 2.0)
    for _ in range(50):
        middle = (lower + upper) / 2
        outside = a * middle**2 - 1 > c * np.cbrt(middle) ** 5
        lower, upper = np.where(outside, lower, middle), np.where(outside, middle, upper)
    return make_mesh(ball.vertices * upper[:, None], ball.faces, name="heart")


def _star() -> Mesh:
    """Five-pointed star with a flat rim and a pyramid on either face."""
    angle = np.pi / 2 + np.arange(10) * np.pi / 5
    radius = np.where(np.arange(10) % 2 == 0, 12.0, 6.0)
    outline = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    rings = np.stack([np.column_stack([outline, np.full(10, z)]) for z in (-2.2, 2.2)])
    return _loft(rings, np.array([[0.0, 0.0, -4.8], [0.0, 0.0, 4.8]]))


def _teapot() -> Mesh:
    """A teapot of overlapping parts: body, lid with knob, spout and handle."""
    bowl = [(3.9, 0), (4.3, 0.3), (4.4, 0.8), (6.4, 2.6), (7.2, 4.6), (6.6, 6.8), (5.2, 8.6)]
    rim = [(4.7, 9.1), (4.9, 9.5), (4.6, 9.8)]
    dome = [(4.3, 9.0), (4.3, 9.8), (3.4, 10.6), (1.6, 11.3), (0.8, 11.7), (0.8, 12.0)]
    knob = [(1.4, 12.5), (1.5, 13.0), (1.1, 13.6)]
    body = _revolve([(0, 0), *bowl, *rim, (0, 9.8)])
    lid = _revolve([(0, 9.0), *dome, *knob, (0, 13.8)])
    spout = _tube([(5.0, 3.2), (10.6, 2.8), (8.6, 8.4), (12.9, 9.6)], [2.4, 1.8, 1.25, 1.1, 1.2])
    handle = _tube([(-5.4, 8.4), (-13.9, 10.2), (-12.9, 1.6), (-6.2, 2.8)], [1.1, 1.0, 1.0, 1.1])
    return _join([body, lid, spout, handle])


def _revolve(profile: Sequence[tuple[float, float]]) -> Mesh:
    """Turn a smoothed profile of (radius, height), from axis to axis, about the y axis."""
    radius, height = _smooth(profile, 80).T
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    circle = np.stack([np.cos(angle), np.zeros(64), np.sin(angle)], axis=1)
    axis = np.outer(height, [0, 1, 0])
    rings = axis[:, None] + radius[:, None, None] * circle
    return _loft(rings[1:-1], axis[[0, -1]])


def _tube(curve: Sequence[tuple[float, float]], radii: Sequence[float]) -> Mesh:
    """Sweep a circle of varying radius along a cubic Bezier curve in the xy plane."""
    t = np.linspace(0, 1, 48)[:, None]
    control = np.asarray(curve, np.float64)
    centre = np.pad(_bezier(control, t), ((0, 0), (0, 1)))
    x, y = _bezier(np.diff(control, axis=0), t).T
    normal = np.stack([-y, x, np.zeros_like(x)], axis=1) / np.hypot(x, y)[:, None]
    radius = scipy.interpolate.PchipInterpolator(np.linspace(0, 1, len(radii)), radii)(t)
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)[:, None]
    circle = normal[:, None] * np.cos(angle) + np.sin(angle) * [0, 0, 1]
    return _loft(centre[:, None] + radius[:, None] * circle, centre[[0, -1]])


def _bezier(control: Floats, t: Floats) -> Floats:
    """Points of a Bezier curve at parameters t, shape [n, 1], by de Casteljau's construction."""
    points: list[Floats] = list(control)
    while len(points) > 1:
        points = [(1 - t) * a + t * b for a, b in pairwise(points)]
    return points[0]


def _smooth(points: Sequence[tuple[float, float]], count: int) -> Floats:
    """Points at equal parameter distances on a smooth curve through the given ones."""
    knots = np.asarray(points, np.float64)
    length = np.linalg.norm(np.diff(knots, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(length)])
    curve: Floats = scipy.interpolate.PchipInterpolator(at, knots)(np.linspace(0, at[-1], count))
    return curve


def _loft(rings: Floats, caps: Floats) -> Mesh:
    """Close the surface through rings of points, shape [k, n, 3], by a point at either end."""
    k, n, _ = rings.shape
    index = np.arange(k * n).reshape(k, n)
    following = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], following[:-1], following[1:], index[1:]
    first, last = np.full(n, k * n), np.full(n, k * n + 1)
    triangles = [
        np.stack([a, b, c], axis=-1),
        np.stack([a, c, d], axis=-1),
        np.stack([following[0], index[0], first], axis=-1),
        np.stack([index[-1], following[-1], last], axis=-1),
    ]
    faces = np.concatenate([triangle.reshape(-1, 3) for triangle in triangles])
    return make_mesh(np.concatenate([rings.reshape(-1, 3), caps]), faces, name="part")


def _join(parts: Sequence[Mesh]) -> Mesh:
    """Put parts beside or into one another; where they overlap the winding number is 2."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    return make_mesh(
        np.concatenate([part.vertices for part in parts]), np.concatenate(faces), name="joined"
    )


def _text(text: str) -> Mesh:
    """A text as extruded letters."""
    if not text.split() or len(text) > TEXT_LIMIT:
        raise MeshError(
            f"A text shape must have 1 to {TEXT_LIMIT} characters, not only spaces.",
            "Use, for instance, text:Hello.",
        )
    require("matplotlib", "shapely", "mapbox_earcut", extra="text", purpose="A text shape")
    from morph_engine.geometry.text import extruded_letters  # Matplotlib takes its time

    return _join(extruded_letters(text))


_SHAPES: dict[str, Callable[[], Mesh]] = {
    "sphere": _sphere,
    "torus": _torus,
    "heart": _heart,
    "star": _star,
    "teapot": _teapot,
}
