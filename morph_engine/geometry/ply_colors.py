"""Colours in PLY files that are larger than bytes, of which trimesh keeps the lowest eight bits."""

from __future__ import annotations

from typing import Any

import lazy_loader as lazy
import numpy as np

trimesh: Any = lazy.load("trimesh")

CHANNELS = ("red", "green", "blue", "alpha")


def scale_colors(scene: Any) -> None:
    """Scale the colours of PLY files with 16 or 32 bits to bytes, in place.

    Some files have bytes in numbers of such types: they stay.

    Args:
        scene: A scene as trimesh has read it.
    """
    for geometry in scene.geometry.values():
        if not isinstance(geometry, trimesh.Trimesh):
            continue
        kind = geometry.visual.kind
        element = geometry.metadata.get("_ply_raw", {}).get(kind)
        if kind not in ("vertex", "face") or element is None:
            continue
        names = [name for name in CHANNELS if name in element["properties"]]
        colors = np.column_stack([element["data"][name] for name in names])
        if colors.dtype.kind == "u" and colors.max(initial=0) > 255:
            shares = colors / np.iinfo(colors.dtype).max
            setattr(geometry.visual, f"{kind}_colors", np.rint(255 * shares).astype(np.uint8))
