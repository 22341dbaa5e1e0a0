"""The light of points and corners in formats that hold one colour each."""

from __future__ import annotations

from morph_engine.rendering import colormap
from morph_engine.results.fields import FIELDS
from morph_engine.results.selection import Snapshot
from morph_engine.srgb import Light, from_bytes, linear


def vertex_light(snapshot: Snapshot) -> Light | None:
    """Linear RGB by the first field, or that of the shapes, shape [v, 3]; None without either."""
    for name, values in snapshot.fields.items():
        diverging = FIELDS[name].diverging
        low, high = colormap.limits(values, diverging=diverging)
        chosen = colormap.DIVERGING if diverging else colormap.SEQUENTIAL
        return linear(colormap.colors(values, low, high, palette=chosen))
    return None if snapshot.colors is None else from_bytes(snapshot.colors)
