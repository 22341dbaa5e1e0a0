"""The colours of the particles of a job that runs."""

from __future__ import annotations

from pathlib import Path

from chamfer_morph.worker import frame_reader
from chamfer_morph.worker.sandbox.runner import Answer


def run(result: Path) -> Answer:
    """Look them up in the shapes.

    Args:
        result: The job's result file, whether it is there or not.

    Returns:
        `Colors.reached`, and behind it `Colors.rgb`; an empty list where there are none.

    Raises:
        ResultError: A frame is damaged.
    """
    colors = frame_reader.look_up_colors(result)
    return Answer(colors.reached, colors.rgb.tobytes()) if colors else Answer([])
