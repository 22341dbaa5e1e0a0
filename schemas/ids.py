"""Ids of jobs, sweeps and exports: 26 characters of Crockford's base 32."""

from __future__ import annotations

import hashlib
import re
import secrets
import time

PATTERN = "[0-9a-z]{26}"

_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"


def new_id() -> str:
    """An id that sorts by time: 48 bits of milliseconds, 80 random bits."""
    return _encode(int(time.time() * 1000) << 80 | secrets.randbits(80))


def derived_id(text: str) -> str:
    """The id that follows from a text."""
    digest = hashlib.sha256(text.encode()).digest()
    return _encode(int.from_bytes(digest[:17], "big") >> 6)


def is_id(text: str) -> bool:
    """Whether a text may be an id."""
    return re.fullmatch(PATTERN, text) is not None


def _encode(number: int) -> str:
    return "".join(_ALPHABET[number >> shift & 31] for shift in range(125, -1, -5))
