"""Figures of the theory and of the 2D experiment, as the reproduction draws them."""

from __future__ import annotations

import tempfile
from pathlib import Path

from chamfer_morph.reproduction.registry import STANDALONE

FILES = {"planar": "circle-to-star.png", "propositions": "propositions.png"}
"""What the documentation calls the figure of an experiment."""


def theory_pictures(folder: Path) -> None:
    """Compute each experiment and keep its figure.

    Args:
        folder: Where the pictures are written.
    """
    for name, file in FILES.items():
        with tempfile.TemporaryDirectory() as scratch:
            (figure,) = STANDALONE[name].section(Path(scratch)).figures
        (folder / file).write_bytes(figure.png)
        print(file)
