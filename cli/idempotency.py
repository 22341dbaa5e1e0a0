"""Requests that make jobs, which may be repeated after Ctrl-C without making them twice."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from chamfer_morph.cli import interrupt


@contextmanager
def repeatable(key: str | None, what: str) -> Iterator[str]:
    """Within, Ctrl-C says how to repeat a request with the same idempotency key.

    Args:
        key: The key that the user has given, if any; else a new one is made.
        what: What is made, such as "the job".

    Yields:
        The key.
    """
    import uuid

    key = key or str(uuid.uuid4())
    report = partial(
        interrupt.report,
        f"Stopped by Ctrl-C; {what} may have been submitted.",
        f"Check with morph jobs, or repeat the command with --idempotency-key {key}.",
    )
    with interrupt.at_interrupt(report):
        yield key
