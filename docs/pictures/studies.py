"""Figures of the theory and of the 2D experiment, from the reproduction's own studies."""

from __future__ import annotations

import tempfile
from pathlib import Path

from chamfer_morph.reproduction.studies import STUDIES

NAMES = {"planar": "circle-to-star.png", "propositions": "propositions.png"}
"""What the documentation calls the figure of a study."""


def study_pictures(folder: Path) -> None:
    """Compute each study and keep its figure.

    Args:
        folder: Where the pictures are written.
    """
    for name, file in NAMES.items():
        with tempfile.TemporaryDirectory() as scratch:
            (picture,) = STUDIES[name].section(Path(scratch)).pictures
        (folder / file).write_bytes(picture.png)
        print(file)
