"""Letters as solids."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

import matplotlib
import numpy as np
import trimesh
from matplotlib.font_manager import FontEntry, fontManager, get_font
from matplotlib.ft2font import FT2Font
from matplotlib.path import Path as Outline
from matplotlib.textpath import text_to_path
from shapely import MultiPolygon, Polygon, unary_union
from shapely.affinity import scale, translate
from shapely.geometry.base import BaseGeometry

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
    font = get_font(_typefaces(text))
    font.set_size(FONT_SIZE, 72)
    outline = min((_outline(lines, font) for lines in sorted(layouts)), key=_span)
    if outline.is_empty:
        raise MeshError("None of these characters is visible.", "Use, for instance, text:Hello.")
    size = TEXT_SPAN / _span(outline)
    outline = scale(outline, size, size, origin=(0, 0))
    line = LINE_HEIGHT * size
    depth = float(np.clip(REFERENCE_VOLUME / outline.area, line / 4, 0.8 * line))
    letters = [trimesh.creation.extrude_polygon(part, depth) for part in outline.geoms]
    return [make_mesh(part.vertices, part.faces, name=text) for part in letters]


def _outline(lines: Sequence[str], font: FT2Font) -> MultiPolygon:
    """Outline of centred lines; Matplotlib 3.11 and later join letters as their script does."""
    rows = []
    for row, line in enumerate(lines):
        placed, glyphs, _ = text_to_path.get_glyphs_with_font(font, line)
        shapes = {name: _area(*glyph) for name, glyph in glyphs.items()}
        ink = unary_union([translate(shapes[name], x, y) for name, x, y, _ in placed])
        if not ink.is_empty:
            left, _, right, _ = ink.bounds
            rows.append(translate(ink, -(left + right) / 2, -row * LINE_HEIGHT))
    ink = unary_union(rows)
    return MultiPolygon([part for part in getattr(ink, "geoms", [ink]) if part.area])


def _area(vertices: np.ndarray, codes: np.ndarray) -> BaseGeometry:
    """What the contours of a glyph enclose: a contour within another is a hole."""
    contours = Outline(vertices, codes).to_polygons()
    return reduce(Polygon.symmetric_difference, map(Polygon, contours), Polygon())


def _typefaces(text: str) -> list[str]:
    """Files of DejaVu Sans Bold, which comes with Matplotlib, and of fonts for what it lacks.

    Those are looked for among the fonts that are installed: bold ones first, then by name.
    """
    files = [str(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf"))]
    missing = _missing(files[0], {character for character in text if not character.isspace()})
    installed = (font for font in fontManager.ttflist if not font.name.startswith("Last Resort"))
    for font in sorted(installed, key=_preference):
        if not missing:
            break
        still_missing = _missing(font.fname, missing)
        if still_missing != missing:
            files.append(font.fname)
            missing = still_missing
    if missing:
        raise MeshError(
            f"No installed font has the character {min(missing)!r}.",
            "Use other characters, or install a font that has them where morph runs.",
        )
    return files


def _preference(font: FontEntry) -> tuple[bool, bool, str, str]:
    return (
        font.style != "normal",
        str(font.weight) not in ("bold", "700"),
        font.name,
        Path(font.fname).name,
    )


def _missing(file: str, characters: set[str]) -> set[str]:
    try:
        font = FT2Font(file)
    except OSError:  # it is in Matplotlib's list, and gone since, or not ours to read
        return characters
    return {character for character in characters if not font.get_char_index(ord(character))}


def _span(outline: MultiPolygon) -> float:
    left, bottom, right, top = outline.bounds
    return float(max(right - left, top - bottom))
