"""Morph one 3D shape into another by physics, and measure honestly how well.

from morph_engine import configure, morph

for frame in morph("sphere", "star", configure("fast", {"frames": 20})):
print(frame.index, frame.metrics["two_sided"])
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from morph_engine.errors import MorphError

if TYPE_CHECKING:
    from morph_engine.config import MorphConfig
    from morph_engine.geometry.mesh import Mesh, load_mesh
    from morph_engine.morphing import Frame, morph
    from morph_engine.presets import configure
    from morph_engine.results.trajectory import Trajectory

_HOMES = {
    "Frame": "morphing",
    "Mesh": "geometry.mesh",
    "MorphConfig": "config",
    "Trajectory": "results.trajectory",
    "configure": "presets",
    "load_mesh": "geometry.mesh",
    "morph": "morphing",
}

__all__ = [
    "Frame",
    "Mesh",
    "MorphConfig",
    "MorphError",
    "Trajectory",
    "configure",
    "load_mesh",
    "morph",
]


def __getattr__(name: str) -> Any:
    """Import on first use: Taichi takes a second to load, and not every use needs it."""
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
