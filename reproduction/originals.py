"""The public originals of the paper's meshes, and how each becomes the mesh of the paper.

As measured, the paper's Bunny, Duck, Cow and Teapot have the vertices of their originals, turned by
right angles, scaled and moved, to 2e-6 grid units; its Sphere is an icosahedron subdivided once, to
7e-5. The authors' dragon, heart and letters are not public: others stand in for them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from chamfer_morph.reproduction.archive import FILE_LIMIT, read_member
from chamfer_morph.reproduction.meshes import ASSETS
from morph_engine.errors import MeshError
from morph_engine.files import replacing
from morph_engine.geometry.mesh import Mesh, load_mesh, make_mesh
from morph_engine.geometry.shapes import make
from morph_engine.geometry.topology import triangle_areas

Floats = npt.NDArray[np.float64]
Rotation = tuple[tuple[int, int, int], tuple[int, int, int], tuple[int, int, int]]

TOLERANCE = 1e-5
"""Relative, of volume and area: they agree to 6e-8 when computed from the paper's six decimals."""

BOUNDS_TOLERANCE = 1e-3
"""Of the bounding box [grid units], of which four decimals are known."""

DRAGON_LENGTH = 26.0
"""Length of the dragon [grid units], which fits the domain; the authors' is 27 and touches it."""


@dataclass(frozen=True)
class Original:
    """A public file.

    Attributes:
        url: Where its author or keeper offers it.
        member: Name of the mesh in it; that of the file itself if it is no archive.
        credit: Whose work it is, and its terms.
        sha256: Its digest in hexadecimal; empty where we have not had the file to compute it from.
    """

    url: str
    member: str
    credit: str
    sha256: str = ""

    @property
    def name(self) -> str:
        """Name of the file."""
        return PurePosixPath(self.url).name


@dataclass(frozen=True)
class Facts:
    """What a mesh of the paper is known by.

    Attributes:
        face_count: Triangles.
        volume: Volume that `Mesh.volume` gives [grid units^3].
        area: Area of all triangles [grid units^2].
    """

    face_count: int
    volume: float
    area: float


@dataclass(frozen=True)
class Recipe:
    """How a mesh of the paper is made.

    Attributes:
        original: What it is made from; None where it needs no file.
        build: Makes it, in grid units, from the mesh of the original.
        facts: What it has to be like; None where it stands in for a mesh that is not public.
    """

    original: Original | None
    build: Callable[[Mesh | None], Mesh]
    facts: Facts | None = None

    @property
    def stands_in(self) -> bool:
        """Whether it is another mesh than the paper's."""
        return self.facts is None


_Y_TO_Z: Rotation = ((0, 0, 1), (1, 0, 0), (0, 1, 0))
"""From y upwards to z upwards: (x, y, z) becomes (z, x, y)."""


def _placed(
    scale: float,
    rotation: Rotation = _Y_TO_Z,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    decimals: int | None = None,
) -> Callable[[Mesh | None], Mesh]:
    """Round to so many decimals, turn, scale and move the original."""

    def build(mesh: Mesh | None) -> Mesh:
        assert mesh is not None
        vertices = mesh.vertices if decimals is None else _rounded(mesh.vertices, decimals)
        return _moved(mesh, scale * vertices @ np.array(rotation).T + offset)

    return build


def _rounded(vertices: Floats, decimals: int) -> Floats:
    """As a program prints them that keeps coordinates in single precision."""
    single: Floats = vertices.astype(np.float32).astype(np.float64)
    return np.round(single, decimals)


def _moved(mesh: Mesh, vertices: Floats) -> Mesh:
    return make_mesh(vertices, mesh.faces, name=mesh.name)


def _dragon(mesh: Mesh | None) -> Mesh:
    """The dragon upright and lengthwise along z, in the middle of the domain."""
    assert mesh is not None
    vertices = mesh.vertices @ np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]).T
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    scale = DRAGON_LENGTH / (upper - lower).max()
    return _moved(mesh, scale * (vertices - (lower + upper) / 2))


def _sphere(_: Mesh | None) -> Mesh:
    """An icosahedron with a vertex at each pole of z, subdivided once."""
    angle = np.arange(5) * 2 * np.pi / 5
    ring = np.stack([2 * np.cos(angle), 2 * np.sin(angle), np.ones(5)], axis=1) / np.sqrt(5)
    half = np.vstack([[0.0, 0.0, 1.0], ring])
    corners = np.vstack([half, -half])
    distance = np.linalg.norm(corners[:, None] - corners, axis=2)
    first, second = np.nonzero(np.triu(np.isclose(distance, distance[distance > 0].min())))
    middles = corners[first] + corners[second]
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    vertices = np.vstack([corners, middles])
    faces = ConvexHull(vertices).simplices
    normals = np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2)))
    inward = (normals * vertices[faces[:, 0]]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return make_mesh(7.25 * vertices + (0, 0, -0.625), faces, name="sphere")


def _built_in(shape: str, name: str) -> Callable[[Mesh | None], Mesh]:
    """A built-in shape, stretched along each axis to the bounds of one of the paper's meshes."""

    def build(_: Mesh | None) -> Mesh:
        mesh, bounds = make(shape), np.array(ASSETS[name].bounds)
        vertices = mesh.vertices @ np.array(_Y_TO_Z).T
        lower, upper = vertices.min(axis=0), vertices.max(axis=0)
        size = (bounds[1] - bounds[0]) / (upper - lower)
        return _moved(mesh, bounds[0] + size * (vertices - lower))

    return build


_STANFORD = "Stanford University Computer Graphics Laboratory; for research, not for sale"
_CRANE = "https://www.cs.cmu.edu/~kmcrane/Projects/ModelRepository"
_TEST_MODELS = "https://raw.githubusercontent.com/alecjacobson/common-3d-test-models"
_SCANS = "https://graphics.stanford.edu/pub/3Dscanrep"

SPOT = Original(f"{_CRANE}/spot.zip", "spot_triangulated.obj", "Keenan Crane, CC0")
BOB = Original(f"{_CRANE}/bob.zip", "bob_tri.obj", "Keenan Crane, CC0")
BUNNY = Original(
    f"{_SCANS}/bunny.tar.gz",
    "bun_zipper.ply",
    _STANFORD,
    "a5720bd96d158df403d153381b8411a727a1d73cff2f33dc9b212d6f75455b84",
)
DRAGON = Original(
    f"{_SCANS}/dragon/dragon_recon.tar.gz",
    "dragon_vrip_res3.ply",
    _STANFORD,
    "74ac1d90989c9b1732edee82d57e9ce71452144cf4355f108d8c9c616d28d02f",
)
TEAPOT = Original(
    f"{_TEST_MODELS}/f96f1e93ec315a43cc771d596fcdc4268bd8b047/data/teapot.obj",
    "teapot.obj",
    "Martin Newell",
    "1b5396fedd74b577e32cef41146582c2f2e1a050d5b4915193c0ac1ad4187ed4",
)

RECIPES = {
    "sphere.obj": Recipe(None, _sphere, Facts(80, 1394.255100, 613.190493)),
    "bunny.obj": Recipe(
        BUNNY,
        _placed(115.5, offset=(-0.958512, 3.094644, -10.872816), decimals=6),
        Facts(69_451, 1134.427853, 762.112317),
    ),
    "duck.obj": Recipe(BOB, _placed(12.5), Facts(10_688, 1345.543070, 891.628942)),
    "cow.obj": Recipe(
        SPOT,
        _placed(11.0, ((-1, 0, 0), (0, 0, 1), (0, 1, 0)), (0.0, -1.1, -1.1)),
        Facts(5_856, 956.002469, 690.851796),
    ),
    "teapot.obj": Recipe(
        TEAPOT, _placed(4.0, offset=(0.0, 0.0, -5.0)), Facts(6_320, 1678.063709, 842.572697)
    ),
    "dragon.obj": Recipe(DRAGON, _dragon),
    "duck_y90.obj": Recipe(
        BOB,
        _placed(12.5, ((0, 1, 0), (1, 0, 0), (0, 0, -1))),
        Facts(10_688, 1345.543070, 891.628942),
    ),
    "heart.obj": Recipe(None, _built_in("heart", "heart.obj")),
    **{
        f"letter_{letter}.obj": Recipe(None, _built_in(f"text:{letter}", f"letter_{letter}.obj"))
        for letter in "CEV"
    },
}
"""How each of `ASSETS` is made."""


def build(name: str, recipe: Recipe, file: Path | None) -> Mesh:
    """Make a mesh of the paper.

    Args:
        name: Its file name, for messages.
        recipe: How it is made.
        file: The original; None where the recipe needs none.

    Returns:
        The mesh in the paper's coordinates [grid units].

    Raises:
        MeshError: The original is damaged, or holds another mesh than the paper used.
        OSError: The original cannot be read.
    """
    source = None
    if recipe.original is not None and file is not None:
        source = _load(file, recipe.original)
    mesh = recipe.build(source)
    if recipe.facts is not None:
        _check(name, mesh, recipe.facts)
    return mesh


def write_mesh(mesh: Mesh, path: Path) -> None:
    """Write a mesh as OBJ with six decimals, in one step.

    Raises:
        OSError: It cannot be written.
    """
    with replacing(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as file:
        np.savetxt(file, mesh.vertices, fmt="v %.6f %.6f %.6f")
        np.savetxt(file, mesh.faces + 1, fmt="f %d %d %d")


def _load(file: Path, original: Original) -> Mesh:
    if original.member != original.name:
        data = read_member(file, original.member)
    elif file.stat().st_size <= FILE_LIMIT:
        data = file.read_bytes()
    else:
        raise MeshError(f"{file.name} is too large for a mesh.", "Fetch it again.")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, original.member)
        path.write_bytes(data)
        return load_mesh(path)


def _check(name: str, mesh: Mesh, facts: Facts) -> None:
    found = Facts(
        len(mesh.faces), mesh.volume, float(triangle_areas(mesh.vertices, mesh.faces).sum())
    )
    same = found.face_count == facts.face_count and np.allclose(
        (found.volume, found.area), (facts.volume, facts.area), rtol=TOLERANCE, atol=0
    )
    difference = f"has {_words(found)}, and the paper's {_words(facts)}"
    bounds = ASSETS[name].bounds if name in ASSETS else None
    if same and bounds is not None:
        same = np.allclose(mesh.bounds, bounds, rtol=0, atol=BOUNDS_TOLERANCE)
        difference = "has a different bounding box than the paper's"
    if not same:
        raise MeshError(
            f"{name}, made from this original, {difference}.",
            "The original differs from that of the paper; use --from to name "
            "a source that has the right one.",
        )


def _words(facts: Facts) -> str:
    return f"{facts.face_count} triangles, volume {facts.volume:.2f} and area {facts.area:.2f}"
