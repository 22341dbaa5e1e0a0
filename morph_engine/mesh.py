"""Triangle meshes: loading and checking.

TEMP
"""

from __future__ import annotations

import hashlib
import io
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh

from morph_engine.errors import MeshError

FORMATS = ("obj", "ply", "stl", "off", "glb", "gltf")


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: Corner positions, shape [v, 3], float64, in the file's own coordinates.
        faces: Vertex indices of the triangles, counter-clockwise from outside, shape [f, 3], int32.
        name: File or shape name, for messages.
        sha256: Digest of the file, or of the arrays of a built-in shape.
        repairs: Sentences on what was changed on loading.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]
    name: str
    sha256: str
    repairs: tuple[str, ...] = ()

    @property
    def volume(self) -> float:
        """Signed volume of the triangle soup, in cubic units of the vertices."""
        corners = (self.vertices - self.vertices.mean(axis=0))[self.faces]
        return float(np.linalg.det(corners).sum() / 6)


def make_mesh(
    vertices: npt.ArrayLike, faces: npt.ArrayLike, *, name: str, sha256: str = ""
) -> Mesh:
    """Check the arrays of a mesh and turn it right side out."""
    points = np.ascontiguousarray(vertices, np.float64)
    triangles = np.ascontiguousarray(faces, np.int32)
    digest = sha256 or hashlib.sha256(points.tobytes() + triangles.tobytes()).hexdigest()
    mesh = Mesh(points, triangles, name, digest)
    if mesh.volume < 0:
        mesh = replace(mesh, faces=mesh.faces[:, ::-1].copy(), repairs=("Turned right side out.",))
    return mesh


def load_mesh(path: str | Path) -> Mesh:
    """Read a mesh from an OBJ, PLY, STL, OFF, GLB or glTF file."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path} cannot be read.", "Check the path.") from error
    loaded = trimesh.load_mesh(
        io.BytesIO(data), file_type=path.suffix[1:].lower(), process=False, skip_materials=True
    )
    return make_mesh(
        loaded.vertices, loaded.faces, name=path.name, sha256=hashlib.sha256(data).hexdigest()
    )
