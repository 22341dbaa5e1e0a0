"""Triangle meshes and the files they come from."""

from __future__ import annotations

import hashlib
import io
import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import lazy_loader as lazy
import numpy as np
import numpy.typing as npt

from morph_engine.errors import MeshError
from morph_engine.geometry.file_colors import Part, read_colors
from morph_engine.geometry.gltf_file import gltf_header, plain_gltf
from morph_engine.geometry.mesh_archive import Companions, mesh_content, read_archive
from morph_engine.geometry.mesh_colors import MeshColors
from morph_engine.geometry.obj_file import has_vertex_colors, plain_obj
from morph_engine.geometry.orientation import reversed_faces
from morph_engine.geometry.ply_colors import scale_colors
from morph_engine.geometry.ply_faces import with_triangles
from morph_engine.geometry.splats import are_splats, solid_of_splats
from morph_engine.geometry.stl_length import without_appendix
from morph_engine.geometry.topology import signed_volume, triangle_areas
from morph_engine.geometry.upward import Up, guess_up

trimesh: Any = lazy.load("trimesh")

PLAIN_FORMATS = ("obj", "ply", "stl", "off", "glb", "gltf")
FORMATS = (*PLAIN_FORMATS, "zip")
TEXT_PREFIX = "text:"
"""Of names of meshes that are texts."""

FILE_BYTES_LIMIT = 256 * 2**20
INSTANCE_LIMIT = 20_000_000
COORDINATE_LIMIT = 1e9

SPLATS_FILLED = "The Gaussian splats have been converted to a solid with a surface around it."

AREA_LIMIT = 30.0
"""Most surface area, in areas of the bounding box; a fine foam has 10, scrambled indices 1000."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh whose faces are counter-clockwise seen from outside.

    Attributes:
        vertices: Corner positions in the file's own coordinates, shape [v, 3], float64.
        faces: Vertex indices of the triangles, shape [f, 3], int32.
        name: File or shape name, for messages.
        sha256: Digest of the file, or of the arrays of a built-in shape.
        repairs: What was changed on loading, one sentence each.
        built_in: Whether it is a built-in shape, in grid units, and comes from no file.
        colors: Colours of its triangles; None where it has none.
        up: The axis that points upwards in it, see `guess_up`; None where nothing tells.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]
    name: str
    sha256: str
    repairs: tuple[str, ...] = ()
    built_in: bool = False
    colors: MeshColors | None = None
    up: Up | None = None

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """Lower and upper corner of the bounding box, shape [2, 3], float64."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def volume(self) -> float:
        """Enclosed volume; overlapping parts count twice."""
        return signed_volume(self.vertices, self.faces)


def make_mesh(
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    *,
    name: str,
    sha256: str | None = None,
    colors: MeshColors | None = None,
    repairs: tuple[str, ...] = (),
) -> Mesh:
    """Make a mesh from arrays, without unused vertices and repeated faces, and right side out.

    Args:
        vertices: Corner positions, shape [v, 3].
        faces: Vertex indices, shape [f, 3].
        name: Name for messages.
        sha256: Digest of its origin; of the arrays by default.
        colors: Colours of the faces.
        repairs: What was changed before.

    Raises:
        MeshError: There are no faces, an index is out of range, a coordinate is not finite or
            beyond 1e9, the mesh has no volume, or its faces criss-cross the bounding box.
    """
    points = np.asarray(vertices, np.float64).reshape(-1, 3)
    corners = np.asarray(faces, np.int64).reshape(-1, 3)
    _check_indices(points, corners, name)
    used, corners = np.unique(corners, return_inverse=True)
    points, triangles = points[used], corners.reshape(-1, 3).astype(np.int32)
    _check_coordinates(points, name)
    distinct = _distinct(points, triangles)
    if len(distinct) < len(triangles):
        repairs += (f"{len(triangles) - len(distinct)} duplicate faces have been removed.",)
        triangles = triangles[distinct]
        colors = colors and colors.of_faces(distinct)
    reversed_ = reversed_faces(points, triangles)
    if reversed_.any():
        triangles, colors = _turned(triangles, colors, reversed_)
        repairs += (f"{np.count_nonzero(reversed_)} faces pointed inwards and have been flipped.",)
    volume = signed_volume(points, triangles)
    if abs(volume) <= 1e-9 * np.linalg.norm(np.ptp(points, axis=0)) ** 3:
        raise MeshError(f"{name} has no volume.", "Use a mesh that encloses a solid.")
    area_ratio = _area_ratio(points, triangles)
    if area_ratio > AREA_LIMIT:
        raise MeshError(
            f"The faces of {name} have {area_ratio:.0f} times the area of its bounding box, as if "
            "their indices were scrambled.",
            "Export the mesh again.",
        )
    if volume < 0:
        triangles, colors = _turned(triangles, colors, np.ones(len(triangles), np.bool_))
        repairs += ("The surface was inside out and has been flipped.",)
    digest = sha256 or _digest(points, triangles, colors)
    return Mesh(points, triangles, name, digest, repairs, colors=colors)


def checked_mesh(mesh: Mesh) -> Mesh:
    """A mesh that somebody has built, with arrays of the types that it is to have.

    Unlike `make_mesh`, it repairs nothing.

    Raises:
        MeshError: Its arrays have other shapes, there are no faces, an index is out of range or no
            integer, or a coordinate is not finite or beyond 1e9.
    """
    points, faces = (_numbers(array, mesh.name) for array in (mesh.vertices, mesh.faces))
    if any(array.ndim != 2 or array.shape[1] != 3 for array in (points, faces) if array.size):
        raise MeshError(
            f"The vertices of {mesh.name} have shape {list(points.shape)}, and its faces "
            f"{list(faces.shape)}.",
            "Give vertices of shape [v, 3], and triangles of shape [f, 3].",
        )
    if (faces != np.trunc(faces)).any():
        raise MeshError(
            f"Faces of {mesh.name} are not integers.",
            "Give the indices of the vertices of each triangle.",
        )
    _check_indices(points, faces, mesh.name)
    _check_coordinates(points, mesh.name)
    return replace(
        mesh,
        vertices=np.asarray(points, np.float64),
        faces=np.asarray(faces, np.int32),
    )


def shape_of_trimesh(model: Any) -> Mesh | npt.NDArray[np.float64]:
    """The shape of an object of trimesh.

    Args:
        model: A `Trimesh`; a `Scene`, which becomes one mesh; or a `PointCloud`.

    Returns:
        A mesh, or the points, shape [n, 3], float64.

    Raises:
        MeshError: As by `make_mesh`, or it is none of them.
    """
    if isinstance(model, trimesh.PointCloud):
        return np.array(model.vertices, np.float64)
    if not isinstance(model, trimesh.Trimesh | trimesh.Scene):
        raise MeshError(
            f"An object of type {type(model).__name__} is no shape.",
            "Give a mesh, points of shape [n, 3], a file, or the name of a built-in shape.",
        )
    name = str(model.metadata.get("file_name") or "mesh")
    scene = trimesh.Scene(model.copy()) if _is_mesh(model) else model.copy()
    if not any(_is_mesh(one) and len(one.faces) for one in scene.geometry.values()):
        raise _no_faces(name)
    materials = (getattr(one.visual, "material", None) for one in scene.geometry.values())
    is_gltf = any(hasattr(material, "baseColorFactor") for material in materials)
    vertices, faces, colors, left_out = _merged(scene, "glb" if is_gltf else "obj")
    mesh = make_mesh(vertices, faces, name=name, colors=colors, repairs=left_out)
    return replace(mesh, up=guess_up(mesh.vertices, mesh.faces, ""))


def _numbers(array: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    """An array of numbers.

    Raises:
        MeshError: It is none.
    """
    try:
        found = np.asarray(array)
        return found if found.dtype.kind in "iuf" else np.array(found.tolist(), np.float64)
    except (TypeError, ValueError):
        raise MeshError(
            f"Vertices or faces of {name} are not arrays of numbers.",
            "Give vertices of shape [v, 3], and triangles of shape [f, 3].",
        ) from None


def _check_indices(points: npt.NDArray[Any], faces: npt.NDArray[Any], name: str) -> None:
    """Refuse a mesh without faces, or of faces without vertices."""
    if not len(faces):
        raise _no_faces(name)
    if faces.min() < 0 or faces.max() >= len(points):
        raise _index_error(name)


def _check_coordinates(points: npt.NDArray[Any], name: str) -> None:
    """Refuse a mesh with vertices that are nowhere, or too far away."""
    broken = np.count_nonzero(~np.isfinite(points).all(axis=1))
    if broken:
        raise MeshError(
            f"{broken} of the {len(points)} vertices of {name} are not finite numbers.",
            "Export the mesh again, or delete these vertices.",
        )
    if np.abs(points).max() > COORDINATE_LIMIT:
        raise MeshError(
            f"{name} has coordinates beyond {COORDINATE_LIMIT:.0e}.",
            "Move it to the origin and scale it down.",
        )


def _turned(
    triangles: npt.NDArray[np.int32],
    colors: MeshColors | None,
    which: npt.NDArray[np.bool_],
) -> tuple[npt.NDArray[np.int32], MeshColors | None]:
    """Triangles, some of which have their corners in opposite order, and their colours."""
    turned = np.where(which[:, None], triangles[:, ::-1], triangles)
    return np.ascontiguousarray(turned), colors and colors.turned(which)


def _digest(
    points: npt.NDArray[np.float64],
    triangles: npt.NDArray[np.int32],
    colors: MeshColors | None,
) -> str:
    digest = hashlib.sha256(points.tobytes() + triangles.tobytes())
    for array in (colors.arrays() if colors else {}).values():
        digest.update(array.tobytes())
    return digest.hexdigest()


def load_mesh(path: str | Path) -> Mesh:
    """Read a mesh and turn it right side out; its coordinates stay as in the file (algorithm 1.1).

    It is an OBJ, PLY, STL, OFF, GLB or self-contained glTF file, or a ZIP archive of one and the
    files that it names: an OBJ's materials, a glTF's buffers, the pictures of both. A scene becomes
    one mesh, and Gaussian splats in a PLY file the surface of a solid.

    Raises:
        MeshError: The file is missing, empty, too large or unreadable, or its mesh is unusable.
    """
    path = Path(path)
    kind = path.suffix[1:].lower()
    if kind not in FORMATS:
        raise MeshError(
            f"{path.name} is not in a known mesh format.",
            "Export it as OBJ, PLY, STL, OFF or GLB.",
        )
    data = _read(path)
    try:
        content, kind, companions = _content(data, path.name, kind)
        vertices, faces, colors, left_out = _parse(content, kind, companions)
    except MeshError:
        raise
    except IndexError as error:
        raise _index_error(path.name) from error
    except Exception as error:  # parsers raise anything on a damaged file
        raise MeshError(
            f"{path.name} is not a readable {kind.upper()} file.",
            "Check that the file is complete, or export the mesh again as OBJ, STL or GLB.",
        ) from error
    if companions and companions.missing:
        left_out += (f"{companions.missing[0]} is not in the archive and has been ignored.",)
    materials = re.search(rb"^mtllib\s+(\S.*?)\s*$", content, re.MULTILINE)
    if kind == "obj" and materials and not companions and colors is None:
        name = materials[1].decode("utf-8", "replace")
        left_out += (f"To use the colours of {name}, put both files into a ZIP archive.",)
    mesh = make_mesh(
        vertices,
        faces,
        name=path.name,
        sha256=hashlib.sha256(data).hexdigest(),
        colors=colors,
        repairs=left_out,
    )
    return replace(mesh, up=guess_up(mesh.vertices, mesh.faces, kind))


def _distinct(
    points: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]
) -> npt.NDArray[np.intp]:
    """Ascending indices of the faces that repeat no earlier one, corner by corner."""
    _, same = np.unique(points, axis=0, return_inverse=True)
    corners = same.reshape(-1)[triangles]
    turn = corners.argmin(axis=1)[:, None] + np.arange(3)
    _, first = np.unique(np.take_along_axis(corners, turn % 3, axis=1), axis=0, return_index=True)
    return np.sort(first)


def _area_ratio(points: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]) -> float:
    """Area of the faces divided by that of the bounding box."""
    width, height, depth = np.ptp(points, axis=0)
    area = triangle_areas(points, triangles).sum()
    return float(area / (2 * (width * height + height * depth + depth * width)))


def _read(path: Path) -> bytes:
    """Read a whole file of reasonable size."""
    try:
        size = path.stat().st_size
        if size > FILE_BYTES_LIMIT:
            raise MeshError(
                f"{path.name} has {size / 2**20:.0f} MiB, more than {FILE_BYTES_LIMIT >> 20}.",
                "Decimate the mesh; the simulation resolves no detail below half a grid unit.",
            )
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(
            f"{path} cannot be read: {error.strerror or error}.",
            "Check the path, or use a built-in shape (morph shapes lists them).",
        ) from error
    if not data.strip():
        raise MeshError(f"{path.name} is empty.", "Export the mesh again.")
    return data


def _content(data: bytes, name: str, kind: str) -> tuple[bytes, str, Companions | None]:
    """A mesh file itself, or the one in an archive: content, format, and the files it may name."""
    if kind != "zip":
        return data, kind, None
    path, members = read_archive(data, name, PLAIN_FORMATS, FILE_BYTES_LIMIT)
    kind = Path(path).suffix[1:].lower()
    return mesh_content(path, members), kind, Companions(members, path)


def _parse(
    data: bytes, kind: str, companions: Companions | None
) -> tuple[npt.ArrayLike, npt.ArrayLike, MeshColors | None, tuple[str, ...]]:
    """Vertices, faces and colours of a mesh file, opening no other file; what is left out."""
    is_gltf = kind in ("glb", "gltf")
    materials = is_gltf or companions is not None
    if kind == "obj":
        data = plain_obj(data)
        if companions and has_vertex_colors(data):  # trimesh takes a plain material instead
            materials = companions.have_pictures
    elif is_gltf:
        _check_gltf(data, kind)
        data, kind = plain_gltf(data, kind), "glb"
    elif kind == "ply":
        data = with_triangles(data)
    elif kind == "stl":
        data = without_appendix(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # NumPy only warns when text between numbers makes it stop reading.
        warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
        scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=kind,
            process=False,
            resolver=companions,
            skip_materials=not materials,
        )
        splats = _splats(scene)
        if splats is not None:
            return *solid_of_splats(splats), (SPLATS_FILLED,)
        scale_colors(scene)
        return _merged(scene, kind)


def _merged(
    scene: Any, kind: str
) -> tuple[npt.ArrayLike, npt.ArrayLike, MeshColors | None, tuple[str, ...]]:
    """Vertices, faces and colours of a scene, which loses its own; what is left out."""
    visuals = {name: one.visual for name, one in scene.geometry.items() if _is_mesh(one)}
    for name in visuals:  # else they are copied, and merged into large pictures
        scene.geometry[name].visual = trimesh.visual.ColorVisuals()
    placed = [one for one in scene.dump() if _is_mesh(one)]
    mesh = trimesh.util.concatenate(placed)
    parts = [Part(visuals[p.metadata["name"]], p.faces, len(p.vertices)) for p in placed]
    colors, left_out = read_colors(parts, kind)
    return mesh.vertices, mesh.faces, colors, left_out


def _splats(scene: Any) -> dict[str, npt.NDArray[np.floating]] | None:
    """Properties of the Gaussian splats that a PLY file holds, if it does."""
    for geometry in scene.geometry.values():
        raw = geometry.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
        names = getattr(getattr(raw, "dtype", None), "names", None)
        if not _is_mesh(geometry) and raw is not None and names and are_splats(names):
            return {name: raw[name] for name in names}
    return None


def _is_mesh(geometry: Any) -> bool:
    return isinstance(geometry, trimesh.Trimesh)


def _check_gltf(data: bytes, kind: str) -> None:
    """Refuse a glTF header that points outside its file or unfolds to more than it holds."""
    header = gltf_header(data, kind)
    accessors: list[dict[str, Any]] = header.get("accessors", [])
    if any(
        not buffer["uri"].startswith("data:")
        for buffer in header.get("buffers", [])
        if "uri" in buffer
    ):
        raise MeshError(
            "The glTF file keeps its geometry in another file.", "Export it as GLB, in one file."
        )
    viewed = sum(view["byteLength"] for view in header.get("bufferViews", []))
    counted = sum(accessor["count"] for accessor in accessors)
    weights = [
        sum(
            accessors[index]["count"]
            for primitive in mesh["primitives"]
            for index in (primitive["attributes"]["POSITION"], primitive.get("indices"))
            if index is not None
        )
        for mesh in header.get("meshes", [])
    ]
    shown = sum(weights[node["mesh"]] for node in header.get("nodes", []) if "mesh" in node)
    if not (max(viewed, counted) <= 4 * len(data) and shown + sum(weights) <= INSTANCE_LIMIT):
        raise MeshError("The glTF file declares more data than it holds.", "Export the mesh again.")


def _no_faces(name: str) -> MeshError:
    return MeshError(f"{name} has no faces.", "Export it as a triangle mesh.")


def _index_error(name: str) -> MeshError:
    return MeshError(
        f"A face of {name} refers to a vertex that does not exist.", "Export the mesh again."
    )
