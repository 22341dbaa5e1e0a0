"""When a call is tried again, and after how long."""

from __future__ import annotations

import random
import time
from email.utils import parsedate_to_datetime

import httpx

from chamfer_morph.client.errors import refusal, unreachable

USUAL = 5
"""Attempts of a single call: a few seconds, enough for a restart of the service."""

PATIENT = 14
"""Attempts in a row of what follows a job for hours: about a minute."""

FIRST_SECONDS, LONGEST_SECONDS = 0.2, 8.0
LONGEST_WAIT_SECONDS = 10.0
"""A service that asks for a longer wait is not waited for: the user should know at once."""

_PASSING = {502, 503, 504}
_NOT_SENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)


class Attempts:
    """Counts failures in a row; each says how long to wait, until there are too many.

    Args:
        server: Address of the service, for messages.
        limit: Number of attempts.
        repeatable: Whether the call may reach the service twice.
    """

    def __init__(self, server: str, *, limit: int = USUAL, repeatable: bool = True) -> None:
        self._server = server
        self._limit = limit
        self._repeatable = repeatable
        self._failures = 0

    def succeeded(self) -> None:
        """Start counting anew."""
        self._failures = 0

    def pause_after_loss(self, error: Exception) -> float:
        """Seconds to wait after a connection failed.

        Raises:
            ServiceError: It is not to be tried again.
        """
        if not (self._repeatable or isinstance(error, _NOT_SENT)) or self._last():
            raise unreachable(self._server, error) from error
        return self._pause()

    def pause_after_refusal(self, response: httpx.Response) -> float:
        """Seconds to wait after an answer with a status of 400 and above.

        Raises:
            ServiceError: It is not to be tried again.
        """
        status = response.status_code
        again = status == 429 or (self._repeatable and status in _PASSING)
        asked = retry_after(response)
        if not again or (asked or 0) > LONGEST_WAIT_SECONDS or self._last():
            raise refusal(response)
        return max(self._pause(), asked or 0)

    def _last(self) -> bool:
        self._failures += 1
        return self._failures >= self._limit

    def _pause(self) -> float:
        longest = min(FIRST_SECONDS * 2.0 ** (self._failures - 1), LONGEST_SECONDS)
        return longest * random.uniform(0.5, 1)


def retry_after(response: httpx.Response) -> float | None:
    """What Retry-After asks for [s], given as seconds or as a date; None without one."""
    text = response.headers.get("retry-after", "")
    if text.isdigit():
        return float(text)
    try:
        return max(parsedate_to_datetime(text).timestamp() - time.time(), 0)
    except ValueError:
        return None
