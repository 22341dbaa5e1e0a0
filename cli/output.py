"""What commands write to standard output: text, or one JSON object with --json."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable

from morph_engine.errors import MorphError

FLAGS = {
    **{name: f"--{name}" for name in ("device", "frames", "out", "resume", "snap", "surface")},
    "states_every": "--states-every",
    "points_per_cell_edge": "--points-per-cell-edge",
    "sampling.points_per_cell_edge": "--points-per-cell-edge",
    "sampling.fit": "--fit",
}
"""Options by the parameter or setting that errors of the library name."""


def print_result(document: object, text: str | Callable[[], None], *, as_json: bool) -> None:
    """Print what a command has come to: all of it as JSON, or else text or what prints that."""
    if as_json:
        print_json(document)
    elif isinstance(text, str):
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()
    else:
        text()


def error_document(error: MorphError) -> dict[str, dict[str, str]]:
    """An error as the JSON that every command prints for it."""
    return {"error": {"cause": error.cause, "remedy": in_flags(error.remedy)}}


def in_flags(text: str) -> str:
    """A remedy in which the names of parameters and settings, in backticks, are options."""
    for name, flag in FLAGS.items():
        text = text.replace(f"`{name}`", flag)
    return text


def print_json(document: object) -> None:
    """Write one JSON object to standard output; models are dumped, inf and nan become null."""
    from pydantic_core import to_jsonable_python

    sys.stdout.write(f"{json.dumps(to_jsonable_python(document, inf_nan_mode='null'), indent=2)}\n")
    sys.stdout.flush()
