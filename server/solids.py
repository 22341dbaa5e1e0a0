"""Size and place of shapes, known without computing anything of them."""

from __future__ import annotations

import threading
from functools import lru_cache
from pathlib import Path

import numpy as np

from chamfer_morph.schemas import MeshShape, Shape
from chamfer_morph.server.context import ServerContext
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.http.problems import ProblemError
from morph_engine.errors import MeshError
from morph_engine.geometry import shapes
from morph_engine.geometry.solid import Solid
from morph_engine.geometry.upward import BY_FORMAT

_one_at_a_time = threading.Lock()


def find_solid(
    shape: Shape, caller: Caller, context: ServerContext, loc: tuple[str | int, ...]
) -> tuple[Solid, str]:
    """What placing a shape needs to know of it, and the shape's name.

    Args:
        shape: An upload that the caller may see, or a built-in shape.
        caller: Who asks.
        context: What endpoints share.
        loc: Where the request names the shape.

    Raises:
        MeshError: There is no such built-in shape, or the mesh has been deleted.
        ProblemError: 422, there is no such mesh.
    """
    if not isinstance(shape, MeshShape):
        return _built_in(shape.shape), shape.shape
    row = context.meshes.get(caller.owner_filter, shape.mesh)
    if row is None or context.storage.mesh_file(shape.mesh) is None:
        raise ProblemError(
            422,
            f"There is no mesh {shape.mesh}.",
            "Upload it first, with POST /v1/meshes.",
            errors=[{"loc": list(loc), "msg": "unknown mesh", "type": "unknown"}],
        )
    report = context.storage.mesh_report(shape.mesh)
    if report is None:
        raise MeshError(
            f"The mesh {row.name} has been deleted in the meantime.", "Upload it again."
        )
    up = report["up"] if "up" in report else BY_FORMAT.get(Path(row.name).suffix[1:].lower())
    return Solid(report["volume"], np.array(report["bounds"], np.float64), up=up), row.name


def _built_in(name: str) -> Solid:
    with _one_at_a_time:  # the first loads libraries, which do not bear to be used meanwhile
        return _make(name)


@lru_cache(maxsize=1000)
def _make(name: str) -> Solid:
    return Solid.of(shapes.make(name))
