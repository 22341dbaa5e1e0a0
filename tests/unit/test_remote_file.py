"""Parts of files that lie elsewhere, as Range asks for them."""

from __future__ import annotations

import pytest
from fastapi import Request

from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.http.remote_file import part_of


def ask(asked: str) -> tuple[int, int]:
    """The part of a file of 100 bytes."""
    request = Request({"type": "http", "headers": [(b"range", asked.encode())]})
    return part_of(request, '"etag"', 100)


@pytest.mark.parametrize(
    ("asked", "part"),
    [
        ("bytes=0-9", (0, 10)),
        ("bytes=90-", (90, 100)),
        ("bytes=-10", (90, 100)),
        ("bytes=90-200", (90, 100)),
        ("bytes=-200", (0, 100)),
        ("bytes=-", (0, 100)),
        ("bytes=0-9,20-29", (0, 100)),
        ("lines=0-9", (0, 100)),
        (f"bytes={'1' * 5000}-", (0, 100)),
        (f"bytes=-{'1' * 5000}", (0, 100)),
        (f"bytes=0-{'1' * 5000}", (0, 100)),
    ],
)
def test_parts(asked: str, part: tuple[int, int]) -> None:
    """One range is honoured; whatever else is asked for, the answer is the whole file."""
    assert ask(asked) == part


@pytest.mark.parametrize("asked", ["bytes=100-", "bytes=9-8", "bytes=-0"])
def test_no_such_part(asked: str) -> None:
    """416, with the size of the file."""
    with pytest.raises(ProblemError) as refused:
        ask(asked)
    assert refused.value.headers["Content-Range"] == "bytes */100"
