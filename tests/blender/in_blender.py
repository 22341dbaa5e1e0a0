"""Scripts that are run in Blender."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

MOST_SECONDS = 900


def found_in_blender(script: str, *arguments: object, folder: Path) -> Any:
    """Run a script of this folder in Blender; returns what it says that it has FOUND.

    Args:
        script: Name of the file.
        arguments: Of its command line.
        folder: Where it runs, and where Blender keeps its settings and extensions.
    """
    outcome = subprocess.run(
        [os.environ["MORPH_BLENDER"], Path(__file__).with_name(script), *map(str, arguments)],
        env=os.environ | {"BLENDER_USER_RESOURCES": str(folder)},
        cwd=folder, capture_output=True, text=True, timeout=MOST_SECONDS,
    )  # fmt: skip
    lines = [line for line in outcome.stdout.splitlines() if line.startswith("FOUND ")]
    if not lines:
        pytest.fail(outcome.stdout[-2000:] + outcome.stderr[-2000:])
    return json.loads(lines[0].removeprefix("FOUND "))


def covered(picture: Path) -> npt.NDArray[np.bool_]:
    """Which pixels of a rendered picture show something, shape [height, width]."""
    shown: npt.NDArray[np.bool_] = np.asarray(Image.open(picture))[..., 3] > 127
    return shown
