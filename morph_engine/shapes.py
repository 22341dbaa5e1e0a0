"""Built-in shapes."""

from __future__ import annotations

import trimesh

from morph_engine.mesh import Mesh, load_mesh, make_mesh


def make(name: str) -> Mesh:
    """Make a built-in shape by name."""
    if name == "torus":
        shape = trimesh.creation.torus(major_radius=8.0, minor_radius=2.9)
    else:
        shape = trimesh.creation.icosphere(subdivisions=4, radius=7.25)
    return make_mesh(shape.vertices, shape.faces, name=name)


def names() -> tuple[str, ...]:
    """Names of the built-in shapes."""
    return ("sphere", "torus")


def resolve_shape(spec: str) -> Mesh:
    """Turn a built-in name or a path into a mesh."""
    return make(spec) if spec in names() else load_mesh(spec)
