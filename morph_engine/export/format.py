"""What a format is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from morph_engine.results.selection import Selection

Kind = Literal["frame", "sequence", "table"]


@dataclass(frozen=True)
class Format:
    """A way to write frames of a result.

    Attributes:
        name: Its name.
        suffix: Ending of its files, with the dot.
        media_type: For HTTP.
        kind: ``frame`` for one frame in a file, ``sequence`` for many, ``table`` for numbers
            without geometry.
        carries: What its files can hold: ``points``, ``surface``, ``fields``, ``tracked``, a
            surface of the same triangles in all frames of one file, ``texture``, its colours as
            pictures; ``picture`` where it is drawn and not geometry, and ``transparency`` where
            nothing has to be behind it.
        timed: Whether it is played, and may have a time of its own.
        extra: The extra of this package that it needs, if any.
        description: What it is, and which programs open it.
        write: Writes a selection to a file. Of kind ``frame``, the selection has one frame, unless
            its surface is tracked.
    """

    name: str
    suffix: str
    kind: Kind
    description: str
    write: Callable[[Selection, Path], Any] = field(repr=False, compare=False)
    carries: frozenset[str] = frozenset()
    timed: bool = False
    media_type: str = "application/octet-stream"
    extra: str | None = None
