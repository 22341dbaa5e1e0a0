"""What commands write to standard output: text, or one JSON object with --json."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable

from morph_engine.errors import MorphError


def print_result(document: object, text: str | Callable[[], None], *, as_json: bool) -> None:
    """Print what a command has come to.

    Args:
        document: All of it, for --json.
        text: The same for people, or what prints that.
        as_json: Whether --json was given.
    """
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
    text = json.dumps(_with_finite_numbers(document), indent=2)
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _with_finite_numbers(value: object) -> object:
    if isinstance(value, dict):
        return {key: _with_finite_numbers(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_finite_numbers(item) for item in value]
    if hasattr(value, "model_dump"):
        return _with_finite_numbers(value.model_dump(mode="json"))
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value
