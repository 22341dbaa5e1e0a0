"""What commands write to standard output: text, or one JSON object with --json."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable

from morph_engine.errors import MorphError


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
    return {"error": {"cause": error.cause, "remedy": error.remedy}}


def print_json(document: object) -> None:
    """Write one JSON object to standard output; models are dumped, inf and nan become null."""
    from pydantic_core import to_jsonable_python

    sys.stdout.write(f"{json.dumps(to_jsonable_python(document, inf_nan_mode='null'), indent=2)}\n")
    sys.stdout.flush()
