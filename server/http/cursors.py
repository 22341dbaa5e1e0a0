"""Opaque cursors: where a listing goes on."""

from __future__ import annotations

import base64
import json
from typing import Annotated

from fastapi import Query
from pydantic import Field, TypeAdapter

from chamfer_morph.server.http.problems import ProblemError

Limit = Annotated[int, Query(ge=1, le=100, description="Items per page.")]
Cursor = Annotated[
    str | None,
    Query(max_length=200, description="`next_cursor` of the previous page; omit it for the first."),
]

_PLACE = TypeAdapter(
    tuple[
        Annotated[int, Field(ge=0, lt=1 << 53, strict=True)],
        Annotated[str, Field(pattern="^[0-9A-Za-z]+$")],
    ]
)


def encode_cursor(age: int, name: str) -> str:
    """A cursor behind an item of an age [any unit since 1970] and a name."""
    return base64.urlsafe_b64encode(json.dumps([age, name]).encode()).decode().rstrip("=")


def decode_cursor(cursor: str | None) -> tuple[int, str] | None:
    """The age and the name in a cursor; None for the first page.

    Raises:
        ProblemError: 422, it was not made by `encode_cursor`.
    """
    if cursor is None:
        return None
    try:
        text = base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True)
        return _PLACE.validate_json(text)
    except ValueError:
        raise ProblemError(
            422, "This cursor is not valid.", "Pass `next_cursor` unchanged, or no cursor."
        ) from None
