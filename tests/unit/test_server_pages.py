"""Cursors, names of uploads, Accept headers, ids of idempotency keys."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from chamfer_morph.schemas.ids import is_id
from chamfer_morph.server.auth import is_loopback
from chamfer_morph.server.database.callers import Caller
from chamfer_morph.server.http import cursors
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.http.uploads import plain_name
from chamfer_morph.server.routes.events import accepts_stream
from chamfer_morph.server.submission import idempotent_id


@given(st.integers(0, 2**53 - 1), st.from_regex(r"[0-9a-z]{26}", fullmatch=True))
def test_a_cursor_comes_back_as_it_was(age: int, name: str) -> None:
    """What was encoded is decoded."""
    assert cursors.decode_cursor(cursors.encode_cursor(age, name)) == (age, name)


@given(st.text(max_size=60))
def test_a_strange_cursor_is_refused(text: str) -> None:
    """Any other text is a 422, not a fault."""
    try:
        cursors.decode_cursor(text)
    except ProblemError as error:
        assert error.status_code == 422


@given(st.text(max_size=300))
def test_the_name_of_an_upload_is_one_plain_name(text: str) -> None:
    """No folders, no control characters, no great length."""
    name = plain_name(text)
    assert len(name) <= 200 and not set(name) & set("/\\") and name.isprintable()


@given(st.text(max_size=40), st.text(max_size=40))
def test_idempotency_keys_make_ids(one: str, other: str) -> None:
    """The same key of the same caller is the same id, any other another one."""
    ann, bob = Caller("ann", "submit"), Caller("bob", "submit")
    asked = ((ann, one), (ann, other), (bob, one))
    ids = [idempotent_id("job", caller, key) for caller, key in asked]
    assert all(map(is_id, ids)) and (ids[0] == ids[1]) == (one == other) and ids[0] != ids[2]


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1", True), ("::1", True), ("[::1]", True), ("localhost", True),
        ("127.9.9.9", True), ("morph.localhost", True), ("0.0.0.0", False), ("::", False),
        ("example.org", False), ("192.168.1.2", False), ("", False), ("127.0.0.1.evil", False),
    ],
)  # fmt: skip
def test_loopback(host: str, expected: bool) -> None:
    """Only what cannot leave the machine counts."""
    assert is_loopback(host) == expected


def test_streams_are_asked_for_by_accept() -> None:
    """Only its own media type makes a stream; a browser's wildcard does not."""
    assert accepts_stream("text/event-stream") and accepts_stream("a/b, Text/Event-Stream;q=0.9")
    assert not accepts_stream("*/*") and not accepts_stream("") and not accepts_stream("text/event")
