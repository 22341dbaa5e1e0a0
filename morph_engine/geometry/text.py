"""Letters as solids."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

import matplotlib
import numpy as np
import trimesh
from matplotlib.ft2font import FT2Font
from matplotlib.path import Path as Outline
from shapely import MultiPolygon, Polygon
from shapely.affinity import scale, translate

from morph_engine.errors import MeshError
from morph_engine.geometry.mesh import Mesh, make_mesh
from morph_engine.geometry.sampling import REFERENCE_VOLUME

TEXT_SPAN = 26.0
"""Width or height of a text [grid units]."""

FONT_SIZE = 100.0
LINE_HEIGHT = 1.15 * FONT_SIZE


def extruded_letters(text: str) -> list[Mesh]:
    """Extrude a text of one word or more, broken into the lines that make it largest.

    Returns:
        The parts of its letters, of a typeface in bold [grid units].

    Raises:
        MeshError: The typeface lacks a character, or none of them leaves a mark.
    """
    words = text.split()
    layouts = {
        tuple(textwrap.wrap(text, width, break_long_words=False))
        for width in range(max(map(len, words)), len(text) + 1)
    }
    outline = min((_outline(lines) for lines in sorted(layouts)), key=_span)
    if outline.is_empty:
        raise MeshError("None of these characters leaves a mark.", "Write for instance text:Hello.")
    size = TEXT_SPAN / _span(outline)
    outline = scale(outline, size, size, origin=(0, 0))
    line = LINE_HEIGHT * size
    depth = float(np.clip(REFERENCE_VOLUME / outline.area, line / 4, 0.8 * line))
    letters = [trimesh.creation.extrude_polygon(part, depth) for part in outline.geoms]
    return [make_mesh(part.vertices, part.faces, name=text) for part in letters]


def _outline(lines: Sequence[str]) -> MultiPolygon:
    """Outline of centred lines of DejaVu Sans Bold, the typeface that comes with Matplotlib."""
    font = FT2Font(str(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf")))
    font.set_size(FONT_SIZE, 72)
    letters = []
    for row, line in enumerate(lines):
        x = 0.0
        placed = []
        for character in line:
            if not font.get_char_index(ord(character)):
                raise MeshError(
                    f"The typeface has no letter {character!r}.", "Use other characters."
                )
            glyph = font.load_char(ord(character))
            contours = Outline(*font.get_path()).to_polygons()
            shape = reduce(Polygon.symmetric_difference, map(Polygon, contours), Polygon())
            placed.append(translate(shape, x, -row * LINE_HEIGHT))
            x += glyph.linearHoriAdvance / 65536
        letters += [translate(shape, -x / 2) for shape in placed]
    return MultiPolygon(
        [part for letter in letters for part in getattr(letter, "geoms", [letter]) if part.area]
    )


def _span(outline: MultiPolygon) -> float:
    left, bottom, right, top = outline.bounds
    return float(max(right - left, top - bottom))
